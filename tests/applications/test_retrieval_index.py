"""The catalogue: exact search is exact, the file is whole or not there, another prior's query is refused."""

import importlib.util
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from helpers.categories import LAPTOP
from omad.applications.retrieval.index import Entry, Hit, ShapeIndex
from omad.applications.retrieval.picture import MOST, ranking_figure
from omad.applications.retrieval.search import ExactSearch
from omad.applications.retrieval.signature import (
    Signature,
    Space,
    check_one_hand,
    estimate_signature,
    fuse,
    prior_fingerprint,
)
from omad.common.errors import InputError
from omad.model.prior import OmadPrior
from omad.output.picture import save
from omad.sensing.observation import Observation

SIZE = LAPTOP.basis_size


def prior(seed: int = 0) -> OmadPrior:
    return OmadPrior(LAPTOP, generator=torch.Generator().manual_seed(seed))


def signatures(betas: np.ndarray, seed: int = 0) -> list[Signature]:
    made = prior_fingerprint(prior(seed), LAPTOP)
    return [Signature(made, beta) for beta in betas]


def filled(count: int = 40, metric: str = "beta") -> tuple[ShapeIndex, np.ndarray]:
    betas = np.random.default_rng(0).standard_normal((count, SIZE))
    index = ShapeIndex(Space.of(prior(), LAPTOP, metric))
    entries = [Entry(f"object {i // 4}", f"file {i}", bytes([i]) * (i % 3)) for i in range(count)]
    index.add(signatures(betas[:10]), entries[:10])
    index.add(signatures(betas[10:]), entries[10:])
    return index, betas


@pytest.mark.parametrize(("rows", "queries", "count"), [(50_000, 3, 10), (40_001, 1, 1), (9000, 4, 64), (5, 2, 10)])
def test_exact_search_finds_what_brute_force_finds(rows, queries, count):
    rng = np.random.default_rng(rows)
    vectors, asked = rng.standard_normal((rows, SIZE)), rng.standard_normal((queries, SIZE))
    found = ExactSearch(vectors).nearest(asked, count)
    truth = np.linalg.norm(asked[:, None] - vectors[None], axis=-1)
    count = min(count, rows)
    assert found.rows.shape == (queries, count)
    np.testing.assert_array_equal(found.rows, np.argsort(truth, axis=1)[:, :count])
    np.testing.assert_allclose(found.distances, np.sort(truth, axis=1)[:, :count], rtol=1e-5)


def test_equally_near_ones_come_in_the_order_in_which_they_were_added():
    vectors = np.tile(np.random.default_rng(0).integers(0, 2, (100, 3)), (300, 1)).astype(np.float32)
    order = np.argsort(vectors.sum(1), kind="stable")  # the squared distances from zero
    np.testing.assert_array_equal(ExactSearch(vectors).nearest(np.zeros((1, 3)), 200).rows[0], order[:200])


def test_far_from_the_origin_the_nearest_are_still_found():
    rng = np.random.default_rng(1)
    vectors = 100 + rng.standard_normal((30_000, 4))
    truth = np.linalg.norm(vectors.astype(np.float32).astype(np.float64) - 100, axis=1)
    found = ExactSearch(vectors).nearest(np.full((1, 4), 100.0), 20)
    np.testing.assert_array_equal(found.rows[0], np.argsort(truth)[:20])


def test_all_there_are_may_be_asked_for():
    vectors = np.random.default_rng(0).standard_normal((3000, 4))
    found = ExactSearch(vectors).nearest(vectors[:2], 3000)
    assert (np.sort(found.rows) == np.arange(3000)).all()
    assert (np.diff(found.distances) >= 0).all()


def test_keypoint_distance_is_that_between_canonical_keypoints_in_metres():
    index, betas = filled(metric="keypoints")
    hits = index.search(signatures(betas[3:4])[0], count=len(index))
    keypoints = prior().keypoints(torch.as_tensor(betas, dtype=torch.float32)).detach().numpy() * LAPTOP.metres_per_unit
    rms = np.sqrt(np.square(keypoints - keypoints[3]).sum(-1).mean(-1))
    assert hits[0].entry.source == "file 3"
    assert [hit.entry.source for hit in hits] == [f"file {row}" for row in np.argsort(rms)]
    np.testing.assert_allclose([hit.distance for hit in hits], np.sort(rms), rtol=1e-4, atol=1e-6)


def test_whitened_distance_counts_the_priors_standard_deviations():
    wide = prior()
    spread = np.linspace(0.5, 3.0, SIZE)
    wide.beta_covariance.copy_(torch.as_tensor(np.diag(spread**2)))
    space = Space.of(wide, LAPTOP, "whitened")
    np.testing.assert_allclose(space.factor @ np.diag(spread), np.eye(SIZE), atol=1e-6)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs CUDA")
@pytest.mark.parametrize("metric", ["keypoints", "whitened"])
def test_a_prior_on_an_accelerator_compares_alike(metric):
    here, there = Space.of(prior(), LAPTOP, metric), Space.of(prior().to("cuda"), LAPTOP, metric)
    assert there.prior == here.prior
    np.testing.assert_allclose(np.abs(there.factor), np.abs(here.factor), rtol=1e-5, atol=1e-9)


def test_search_by_information_ignores_what_the_query_does_not_know():
    index, betas = filled()
    covariance = np.eye(SIZE) * 1e-4
    covariance[0, 0] = 1e6
    asked = betas[7] + 50 * np.eye(SIZE)[0]
    query = Signature(index.space.prior, asked, covariance)
    assert index.search(query, 1)[0].entry.source != "file 7"
    found = index.search(query, 3, by_information=True)
    assert found[0].entry.source == "file 7"
    assert found[0].distance == pytest.approx(50 / 1e3, rel=1e-3)
    with pytest.raises(InputError, match="covariance"):
        index.search(signatures(betas[:1])[0], 1, by_information=True)


def test_every_object_is_named_once_by_its_nearest_entry():
    index, betas = filled()
    query = signatures(betas[17:18])[0]
    best: dict[str, float] = {}
    for hit in index.search(query, len(index)):
        best.setdefault(hit.entry.name, hit.distance)
    found = index.search_objects(query, 10)
    assert [(hit.entry.name, hit.distance) for hit in found] == list(best.items())
    assert len(index.search_objects(query, 3)) == 3
    assert len(index.search_objects(query, 1000)) == 10


def handed(beta: np.ndarray, probability: float | None, prior: str) -> Signature:
    return Signature(prior, beta, None, probability)


def test_mirror_images_are_named_as_such_and_come_behind(tmp_path):
    """At any distance; what is not told surely is not said, and counts as the query's own hand."""
    index = ShapeIndex(Space.of(prior(), LAPTOP, "beta"))
    told = {"image": 1.0, "own, far": 0.0, "own, near": 0.1, "not sure": 0.6}
    shifts = np.array([0.0, 3.0, 1.0, 2.0])[:, None] * np.eye(SIZE)[0]
    entries = [Entry(name) for name in told]
    index.add([handed(*pair, index.space.prior) for pair in zip(shifts, told.values(), strict=True)], entries)
    index.save(tmp_path / "index.npz")
    again = ShapeIndex.load(tmp_path / "index.npz")
    assert again.entries == index.entries
    assert [entry.of_other_hand for entry in again.entries] == [True, False, False, None]
    found = again.search_objects(handed(np.zeros(SIZE), 0.02, index.space.prior), 4)
    said = {hit.entry.name: hit.mirrored for hit in found}
    assert [*said.items()] == [("own, near", False), ("not sure", None), ("own, far", False), ("image", True)]
    nearest = again.search_objects(handed(np.zeros(SIZE), 0.02, index.space.prior), 1)
    assert nearest[0].entry.name == "own, near"
    for unsure in (0.5, None):
        hits = again.search_objects(handed(np.zeros(SIZE), unsure, index.space.prior), 4)
        assert (hits[0].entry.name, {hit.mirrored for hit in hits}) == ("image", {None})
    assert again.search(handed(np.zeros(SIZE), 0.9, index.space.prior), 1)[0].mirrored is False


def test_files_of_before_there_were_hands_are_read(tmp_path):
    index, _ = filled()
    index.save(tmp_path / "index.npz")
    with np.load(tmp_path / "index.npz") as arrays:
        assert b'"hands"' not in arrays["head"].tobytes()
    assert {entry.of_other_hand for entry in ShapeIndex.load(tmp_path / "index.npz").entries} == {None}


def test_views_of_different_hands_are_not_taken_for_one_object():
    made = prior_fingerprint(prior(), LAPTOP)
    left, right, perhaps = (handed(np.full(SIZE, n), p, made) for n, p in ((1.0, 0.01), (2.0, 0.99), (3.0, 0.6)))
    with pytest.raises(InputError, match=r"other hand.*each alone"):
        check_one_hand([left, right])
    assert check_one_hand([left, left]) == check_one_hand([handed(left.beta, None, made)] * 2) == []
    assert "hand: " in check_one_hand([left, perhaps])[0]
    together = fuse([left, perhaps, left])
    np.testing.assert_array_equal(together.beta, left.beta)  # what shows its mirror image does not count
    assert together.of_other_hand is False
    assert fuse([right, perhaps]).of_other_hand is True
    np.testing.assert_array_equal(fuse([right, perhaps]).beta, np.full(SIZE, 2.5))
    assert right.in_mirror().mirrored_probability == pytest.approx(0.01)


def test_an_empty_index_answers_nothing():
    index = ShapeIndex(Space.of(prior(), LAPTOP))
    query = signatures(np.zeros((1, SIZE)))[0]
    assert index.search(query) == []
    assert index.search_objects(query) == []


def test_what_is_saved_comes_back(tmp_path):
    index, betas = filled(metric="keypoints")
    index.save(tmp_path / "deep" / "index.npz")
    again = ShapeIndex.load(tmp_path / "deep" / "index.npz")
    assert again.entries == index.entries
    assert (again.space.prior, again.space.metric, again.backend) == (index.space.prior, "keypoints", "exact")
    query = signatures(betas[5:6] + 0.1)[0]
    assert again.search(query) == index.search(query)
    again.add(signatures(betas[:1]), [Entry("one more")])
    assert len(again) == len(index) + 1


def test_another_priors_signature_is_refused(tmp_path):
    index, betas = filled()
    foreign = signatures(betas[:1], seed=1)
    for ask in (lambda: index.search(foreign[0]), lambda: index.add(foreign, [Entry("x")])):
        with pytest.raises(InputError, match="prior") as refusal:
            ask()
        assert "\n" not in str(refusal.value)
    assert len(index) == 40


def test_signatures_that_cannot_be_are_refused():
    index, betas = filled()
    with pytest.raises(InputError, match="shape"):
        index.search(Signature(index.space.prior, np.zeros(3)))
    with pytest.raises(InputError, match="finite"):
        index.add([Signature(index.space.prior, np.full(SIZE, np.nan))], [Entry("x")])
    with pytest.raises(InputError):
        index.add(signatures(betas[:2]), [Entry("x")])
    with pytest.raises(InputError, match="choose of keypoints, beta, whitened"):
        Space.of(prior(), LAPTOP, "keypoint")
    with pytest.raises(InputError, match="choose of exact, faiss"):
        ShapeIndex(index.space, "flat")


def test_it_keeps_no_array_of_the_callers():
    index, betas = filled(4)
    given = betas[:1].astype(np.float32)
    index.add_betas(given, [Entry("x")])
    given[:] = 9
    assert index.search(signatures(betas[:1])[0], np.int64(2))[1].distance == pytest.approx(0, abs=1e-6)


def test_the_fingerprint_follows_basis_and_category():
    assert prior_fingerprint(prior(), LAPTOP) == prior_fingerprint(prior(), LAPTOP)
    assert prior_fingerprint(prior(1), LAPTOP) != prior_fingerprint(prior(), LAPTOP)
    loose = prior()
    loose.loosen(torch.ones(1, 3, 2))
    assert prior_fingerprint(loose, LAPTOP) != prior_fingerprint(prior(), LAPTOP)


def test_a_crash_while_writing_leaves_the_old_index(tmp_path, monkeypatch):
    path = tmp_path / "index.npz"
    index, betas = filled()
    index.save(path)
    before = path.read_bytes()

    def crash(file, **arrays):
        file.write(b"half of an ind")
        raise KeyboardInterrupt

    index.add(signatures(betas[:1]), [Entry("new")])
    monkeypatch.setattr(np, "savez", crash)
    with pytest.raises(KeyboardInterrupt):
        index.save(path)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]
    assert len(ShapeIndex.load(path)) == 40


def test_no_file_is_written_over_but_an_index(tmp_path):
    path = tmp_path / "depth.npz"
    np.savez(path, depth=np.ones((2, 2)))
    before = path.read_bytes()
    for place in (path, tmp_path):
        with pytest.raises(InputError, match="no file of an index"):
            filled()[0].save(place)
    assert path.read_bytes() == before
    path.write_bytes(b"")  # as tempfile makes one
    for _ in range(2):
        filled()[0].save(path)
    assert len(ShapeIndex.load(path)) == 40


def test_foreign_and_damaged_files_are_named(tmp_path):
    path = tmp_path / "index.npz"
    with pytest.raises(InputError, match=r"index\.npz: "):
        ShapeIndex.load(path)
    filled()[0].save(path)
    whole = path.read_bytes()
    for damaged in (b"", b"nonsense", whole[: len(whole) // 2], whole[:2000] + b"\x00\xff" * 50 + whole[2100:]):
        path.write_bytes(damaged)
        with pytest.raises(InputError, match=r"index\.npz: "):
            ShapeIndex.load(path)
    np.savez(path, betas=np.zeros((2, 3)))
    with pytest.raises(InputError, match=r"index\.npz: "):
        ShapeIndex.load(path)


def test_an_index_of_another_version_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("omad.applications.retrieval.index.FORMAT", "omad-index-0")
    filled()[0].save(tmp_path / "index.npz")
    monkeypatch.undo()
    with pytest.raises(InputError, match=r"index\.npz: .*omad-index-0"):
        ShapeIndex.load(tmp_path / "index.npz")


def test_views_are_fused_by_what_each_knows():
    sure, vague = np.full(SIZE, 1e-2), np.full(SIZE, 1e2)
    first = Signature("p", np.zeros(SIZE), np.diag(np.where(np.arange(SIZE) < 5, sure, vague)))
    second = Signature("p", np.ones(SIZE), np.diag(np.where(np.arange(SIZE) < 5, vague, sure)))
    fused = fuse([first, second])
    np.testing.assert_allclose(fused.beta, np.arange(SIZE) >= 5, atol=1e-3)
    assert fused.covariance is not None
    np.testing.assert_allclose(np.diag(fused.covariance), 1e-2, rtol=1e-3)
    plain = fuse([first, Signature("p", np.ones(SIZE))])
    np.testing.assert_allclose(plain.beta, 0.5)
    held = Signature("p", np.full(SIZE, 2.0), np.zeros((SIZE, SIZE)))  # of an estimate whose beta was known
    np.testing.assert_allclose(fuse([first, held, held]).beta, 2.0, rtol=1e-6)
    with pytest.raises(InputError, match="prior"):
        fuse([first, Signature("q", np.ones(SIZE))])
    with pytest.raises(InputError):
        fuse([])


def test_without_faiss_the_cure_is_named(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "faiss", None)
    index = ShapeIndex(Space.of(prior(), LAPTOP), "faiss")
    index.add(signatures(np.zeros((1, SIZE))), [Entry("x")])
    with pytest.raises(InputError, match=r"omad\[faiss\]"):
        index.search(signatures(np.zeros((1, SIZE)))[0])


@pytest.mark.skipif(importlib.util.find_spec("faiss") is None, reason="FAISS is not installed (extra omad[faiss])")
@pytest.mark.parametrize("views", [1, 20], ids=["shapes at random", "many views of each object"])
def test_faiss_finds_nearly_all_of_the_nearest_and_its_graph_is_kept(tmp_path: Path, views: int):
    rng = np.random.default_rng(0)
    betas = np.repeat(rng.standard_normal((4000 // views, SIZE)), views, axis=0) + 0.1 * rng.standard_normal(
        (4000, SIZE)
    )
    exact, graph = (ShapeIndex(Space.of(prior(), LAPTOP), backend) for backend in ("exact", "faiss"))
    for index in (exact, graph):
        index.add_betas(betas, [Entry(str(i)) for i in range(len(betas))])
    asked = betas[::40] + 0.1 * rng.standard_normal((100, SIZE))
    truth, found = exact.nearest(asked, 10), graph.nearest(asked, 10)
    recall = np.mean([len(set(a) & set(b)) / 10 for a, b in zip(truth.rows, found.rows, strict=True)])
    assert recall > 0.99
    np.testing.assert_allclose(found.distances[:, 0], truth.distances[:, 0], rtol=1e-3)
    graph.save(tmp_path / "index.npz")
    again = ShapeIndex.load(tmp_path / "index.npz")
    np.testing.assert_array_equal(again.nearest(asked, 10).rows, found.rows)
    graph.add_betas(betas[:1] + 9, [Entry("one more")])  # builds the graph anew
    assert graph.nearest(betas[:1] + 9, 1).rows[0, 0] == 4000


def test_information_takes_the_entries_doubt_into_account_and_keeps_it(tmp_path):
    index, betas = filled()
    doubtful = [Signature(index.space.prior, beta, 3 * np.eye(SIZE)) for beta in betas[:10]]
    index.add(doubtful, [Entry(f"again {i}") for i in range(10)])
    np.testing.assert_allclose(index.usual_covariance, 3 * 10 / 50 * np.eye(SIZE))  # 40 were certain
    index.save(tmp_path / "index.npz")
    again = ShapeIndex.load(tmp_path / "index.npz")
    np.testing.assert_allclose(again.usual_covariance, index.usual_covariance)
    query = Signature(index.space.prior, betas[30] + 0.1, 0.4 * np.eye(SIZE))
    hit = again.search(query, 1, by_information=True)[0]
    assert hit.entry.source == "file 30"
    assert hit.distance == pytest.approx(0.1 * np.sqrt(SIZE) / np.sqrt(0.6 + 0.4), rel=1e-4)


def test_what_are_no_signatures_or_entries_is_refused_with_what_to_give():
    index, betas = filled()
    own = signatures(betas[:1])
    for ask in (lambda: index.add(["x"], [Entry("x")]), lambda: index.search("x"), lambda: index.search(betas[0])):
        with pytest.raises(InputError, match=r"signature: is .*; give a Signature: .*estimate_signature makes it"):
            ask()
    for ask in (lambda: index.add(own, ["x"]), lambda: index.add_betas(betas[:1], ["x"])):
        with pytest.raises(InputError, match=r"entry: is str; give .*Entry\(name\)"):
            ask()
    assert len(index) == len(index.betas) == len(betas)


def test_names_in_a_ranking_stay_over_their_panels(tmp_path, recwarn):
    names = ["x" * 300, "a_front_door_of_the_kitchen_as_seen_from_the_left_0001", "new\nline\tand 名前"]
    view = Observation.from_points(np.random.default_rng(0).uniform(0.5, 1.0, (200, 3)))
    figure = ranking_figure([view], [Hit(Entry(name), 0.1) for name in names], "m")
    save(figure, tmp_path / "ranking.png")
    assert not recwarn  # of letters that the font lacks
    for panel in figure.axes:
        title, room = panel.title.get_window_extent(), panel.get_window_extent()
        assert title.width < 1.1 * room.width
        assert panel.get_title().count("\n") <= 1
    assert "0001" in figure.axes[2].get_title()


def test_a_long_ranking_is_no_taller_than_it_needs_to_be():
    view = Observation.from_points(np.random.default_rng(0).uniform(0.5, 1.0, (200, 3)))
    figure = ranking_figure([view], [Hit(Entry(str(number)), 0.1) for number in range(10 * MOST)], "m")
    titles = [panel.get_title() for panel in figure.axes if panel.get_title()]
    assert len(titles) == 1 + MOST
    top = figure.axes[0].get_position().y1
    assert (1 - top) * figure.get_figheight() < 0.5  # inches above the first row


def test_a_signature_is_as_sure_of_the_shape_as_the_estimate():
    beta, covariance = np.arange(4.0), np.diag(np.arange(11.0))  # the base's six, one joint's, and those of beta
    made = estimate_signature(SimpleNamespace(beta=beta, covariance=covariance, category=LAPTOP), "prior")
    assert np.array_equal(made.covariance, np.diag(np.arange(7.0, 11.0)))
