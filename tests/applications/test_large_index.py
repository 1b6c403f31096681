"""The catalogue on disk: it answers as the one in memory, grows, is merged, and survives what happens to it."""

import importlib.util
import json
import os
import signal
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from helpers.categories import LAPTOP
from helpers.numbered import SIZE, SPACE, add_slowly, betas, entries, stream
from helpers.warm import warm
from omad.applications.retrieval.index import Entry, ShapeIndex
from omad.applications.retrieval.large import large_index
from omad.applications.retrieval.large.large_index import LargeIndex, open_index
from omad.applications.retrieval.large.lists import PROBES, ListSearch, learn_centres, sorted_into_lists, write_lists
from omad.applications.retrieval.large.manifest import Manifest
from omad.applications.retrieval.large.parts import MAPPED, Portion
from omad.applications.retrieval.large.stream import _whole_objects
from omad.applications.retrieval.signature import Signature, Space
from omad.cli.main import run
from omad.common.errors import InputError
from omad.common.files import TEMPORARY
from omad.common.processes.locks import only_one
from omad.model.prior import OmadPrior

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("faiss") is None, reason="FAISS is not installed (extra omad[faiss])"
)


def exact(count: int) -> ShapeIndex:
    index = ShapeIndex(SPACE)
    index.add_betas(betas(count), entries(0, count))
    return index


def query(beta: np.ndarray, covariance: np.ndarray | None = None) -> Signature:
    return Signature(SPACE.prior, beta, covariance)


def files(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


@pytest.fixture
def small_parts(monkeypatch):
    monkeypatch.setattr(large_index, "PART_ENTRIES", 700)


def test_it_answers_as_the_exact_search_does_while_it_grows(tmp_path, small_parts):
    index, asked = LargeIndex.create(tmp_path, SPACE), betas(9000)[::90] + 0.1
    for last, step in ((600, 600), (2000, 300), (9000, 500)):
        first = len(index)
        index.add(stream(last, first, step), "numbers")
        found, truth = LargeIndex.open(tmp_path).nearest(asked, 10), exact(last).nearest(asked, 10)
        # all lists are looked at where they are few
        recall = np.mean([len(set(a) & set(b)) / 10 for a, b in zip(truth.rows, found.rows, strict=True)])
        assert recall > 0.99
        np.testing.assert_allclose(found.distances[:, 0], truth.distances[:, 0], rtol=1e-4)
        assert (len(index), index.taken("numbers")) == (last, last)
    hit = LargeIndex.open(tmp_path).search(query(betas(9000)[8765]), 1)[0]
    assert (hit.entry, hit.distance) == (entries(8765, 8766)[0], 0.0)
    np.testing.assert_allclose(index.usual_covariance, 2 * np.eye(SIZE))
    assert len(index.manifest.lists) <= np.log2(9000 / 700) + 1


def test_one_without_entries_answers_nothing(tmp_path):
    asked = query(betas(1)[0], np.eye(SIZE))
    for by_information in (False, True):
        assert LargeIndex.create(tmp_path, SPACE).search_objects(asked, 3, by_information) == []


def test_lists_joined_on_disk_hold_what_the_parts_held(tmp_path):
    """Any order of joining gives the search the same vectors: with every list looked at it is exact."""
    vectors = betas(3000)
    centres = learn_centres(vectors, PROBES)
    parts = [sorted_into_lists(centres, vectors[first : first + 1000], first) for first in (0, 1000, 2000)]
    apart = [write_lists(tmp_path, f"lists-{i:06d}", [part]) for i, part in enumerate(parts)]
    together = write_lists(tmp_path, "lists-000009", parts)
    truth = np.argsort(np.linalg.norm(vectors[:50, None] - vectors, axis=-1), axis=1, kind="stable")[:, :10]
    for lists in (apart, [together]):
        np.testing.assert_array_equal(ListSearch(tmp_path, centres, lists).nearest(vectors[:50], 10).rows, truth)


def test_objects_are_named_once_and_information_weighs(tmp_path):
    index, memory = LargeIndex.create(tmp_path, SPACE), exact(500)
    index.add(stream(500), "numbers")
    memory._covariances = 500 * 2 * np.eye(SIZE)  # as the stream says
    asked = query(betas(500)[17] + 0.2, np.diag(np.linspace(0.1, 9, SIZE)))
    for by_information in (False, True):
        found, truth = (one.search_objects(asked, 5, by_information) for one in (index, memory))
        assert [hit.entry for hit in found] == [hit.entry for hit in truth]
        np.testing.assert_allclose([h.distance for h in found], [h.distance for h in truth], rtol=1e-4)
    assert len(index.search_objects(asked, 1000)) == 250
    with pytest.raises(InputError, match="covariance"):
        index.search(query(betas(1)[0]), 1, by_information=True)


def test_hands_are_kept_and_merged(tmp_path):
    """Of parts whose objects have none, no more is stored than before there were hands."""
    one, into = LargeIndex.create(tmp_path / "one", SPACE), LargeIndex.create(tmp_path / "all", SPACE)
    signatures = [Signature(SPACE.prior, beta, None, p) for beta, p in zip(betas(3), (0.0, 1.0, None), strict=True)]
    one.add([Portion.of(signatures, entries(0, 3), 3, SIZE)], "handed")
    one.add(stream(10), "numbers")
    memory = ShapeIndex(SPACE)
    memory.add(signatures, entries(0, 3))
    for index, name in ((one, "one"), (memory, "memory")):
        into.merge(index, name)
    for index in (LargeIndex.open(tmp_path / "one"), LargeIndex.open(tmp_path / "all"), memory):
        assert [index.search(each, 1)[0].entry.of_other_hand for each in signatures] == [False, True, None]
    found = LargeIndex.open(tmp_path / "one").search_objects(signatures[1], 2)[0]
    assert (found.entry.name, found.mirrored) == ("object 0", False)
    part = one.manifest.parts[1]
    assert np.load(tmp_path / "one" / f"{part.name}.ends.npy").shape == (10, 3)


def test_catalogues_are_merged_once(tmp_path, small_parts):
    """From disk and from memory; what is in already stays out, and what came since comes in."""
    one, into = LargeIndex.create(tmp_path / "one", SPACE), LargeIndex.create(tmp_path / "all", SPACE)
    one.add(stream(1500), "numbers")
    into.merge(one, "one")
    into.merge(exact(300), "two")
    into.merge(one, "one")
    assert len(into) == 1800
    one.add(stream(1600, 1500), "numbers")
    into.merge(one, "one")
    assert len(into) == 1900
    found = LargeIndex.open(tmp_path / "all").search(query(betas(1600)[1599]), 1)[0]
    assert (found.entry, found.distance) == (entries(1599, 1600)[0], 0.0)
    other = Space.of(OmadPrior(LAPTOP, generator=torch.Generator().manual_seed(1)), LAPTOP, "beta")
    with pytest.raises(InputError, match="other weights"):
        into.merge(ShapeIndex(other), "foreign")


def test_a_catalogue_that_was_built_anew_is_not_merged_on(tmp_path):
    into = LargeIndex.create(tmp_path / "all", SPACE)
    into.merge(exact(30), "numbers")
    anew = ShapeIndex(SPACE)
    anew.add_betas(betas(50)[::-1], entries(0, 50))
    with pytest.raises(InputError, match="numbers: its first 30 inputs are not those that are in"):
        into.merge(anew, "numbers")
    into.merge(exact(50), "numbers")
    assert len(LargeIndex.open(tmp_path / "all")) == 50


def test_a_catalogue_that_has_grown_is_merged_on_though_its_betas_are_rounded_otherwise(tmp_path):
    """As those of images are that were estimated in other batches; what is called otherwise is another one."""
    into, anew = LargeIndex.create(tmp_path / "all", SPACE), ShapeIndex(SPACE)
    into.merge(exact(30), "numbers")
    anew.add_betas(betas(50) + 3e-6, entries(0, 50))
    into.merge(anew, "numbers")
    assert len(LargeIndex.open(tmp_path / "all")) == 50
    renamed = ShapeIndex(SPACE)
    renamed.add_betas(betas(50), [*entries(0, 49), Entry("another")])
    with pytest.raises(InputError, match="numbers: its first 50 inputs are not those that are in"):
        into.merge(renamed, "numbers")


def test_catalogues_of_processors_that_round_otherwise_are_merged(tmp_path):
    into = LargeIndex.create(tmp_path / "all", SPACE)
    other = ShapeIndex(replace(SPACE, factor=SPACE.factor + 1e-17))
    other.add_betas(betas(3), entries(0, 3))
    into.merge(other, "elsewhere")
    assert len(into) == 3
    with pytest.raises(InputError, match="another metric"):
        into.merge(ShapeIndex(replace(SPACE, metric="whitened")), "foreign")


def test_what_another_handle_merged_is_not_merged_again(tmp_path):
    one, two = (open_(tmp_path / "all", SPACE) for open_ in (LargeIndex.create, LargeIndex.create))
    for each in (one, two):
        each.merge(exact(50), "numbers")
    assert len(LargeIndex.open(tmp_path / "all")) == 50
    with pytest.raises(InputError, match="is the catalogue itself"):
        one.merge(two, "itself")


def test_inputs_that_came_between_those_that_are_in_are_refused(tmp_path):
    index, names = LargeIndex.create(tmp_path, SPACE), [f"{i:03d}.png" for i in range(300)]
    index.add(stream(200), "numbers", names[:200])
    index.add(stream(300, 200), "numbers", names)  # what comes after them is new
    for others in (["0000.png", *names], names[:299]):
        with pytest.raises(InputError, match="numbers: its first 300 inputs are not those that are in"):
            index.add(stream(301, 300), "numbers", others)
    assert len(LargeIndex.open(tmp_path)) == 300


def test_names_that_are_no_utf8_are_kept_readable(tmp_path):
    index = LargeIndex.create(tmp_path, SPACE)
    index.add([Portion(betas(1), [Entry("bad\udcff", "a\udcff.png", b"")], np.eye(SIZE), 1)])
    assert LargeIndex.open(tmp_path).entry(0) == Entry("bad\\udcff", "a\\udcff.png", b"")


@pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="open files are not told here")
def test_many_parts_need_few_open_files(tmp_path, monkeypatch):
    monkeypatch.setattr(large_index, "PART_ENTRIES", 1)
    before = len(os.listdir("/proc/self/fd"))
    index = LargeIndex.create(tmp_path, SPACE)
    index.add(stream(100, each=1), "numbers")
    assert [index.entry(i) for i in (0, 99)] == [*entries(0, 1), *entries(99, 100)]
    assert len(os.listdir("/proc/self/fd")) < before + 3 * MAPPED + 20


def test_another_writers_file_makes_no_folder_full(tmp_path):
    (tmp_path / f"{TEMPORARY}x.json").touch()
    assert len(LargeIndex.create(tmp_path, SPACE)) == 0


def test_what_cannot_be_merged_is_told_before_anything_is(tmp_path, capsys):
    names = [str(tmp_path / name) for name in ("ours.npz", "foreign.npz")]
    exact(3).save(names[0])
    ShapeIndex(Space.of(OmadPrior(LAPTOP), LAPTOP, "whitened")).save(names[1])
    for said in ("is of other weights or another metric", "no such file"):
        assert run(["index", "merge", *names, "--output", str(tmp_path / "all")]) == 2
        assert f"foreign.npz: {said}" in capsys.readouterr().err
        assert not (tmp_path / "all").exists()
        Path(names[1]).unlink(missing_ok=True)


def test_an_empty_one_answers_nothing(tmp_path):
    index = LargeIndex.create(tmp_path, SPACE)
    assert index.search(query(np.zeros(SIZE))) == []
    index.add([Portion(np.zeros((0, SIZE)), [], np.zeros((SIZE, SIZE)), 7)], "refused")
    assert (len(index), LargeIndex.open(tmp_path).taken("refused")) == (0, 0)


def test_portions_end_with_objects():
    names = [name for name, times in (("a", 100), ("b", 300), ("c", 2)) for _ in range(times)]
    assert [(some[0], some[-1], len(some)) for some in _whole_objects(names, str)] == [("a", "b", 400), ("c", "c", 2)]


def test_what_is_wrong_is_named(tmp_path):
    with pytest.raises(InputError, match=r"manifest\.json"):
        open_index(tmp_path)
    (tmp_path / "mine.txt").write_text("stays")
    with pytest.raises(InputError, match="not empty"):
        LargeIndex.create(tmp_path, SPACE)
    folder = tmp_path / "index"
    index = LargeIndex.create(folder, SPACE)
    index.add(stream(1000), "numbers")
    for metric in ("keypoints", "beta"):
        other = Space.of(OmadPrior(LAPTOP, generator=torch.Generator().manual_seed(1)), LAPTOP, metric)
        with pytest.raises(InputError, match="is a catalogue of prior"):
            LargeIndex.create(folder, other)
    with pytest.raises(InputError, match="betas"):
        index.add([Portion(np.full((1, SIZE), np.nan), entries(0, 1), np.eye(SIZE), 1)])
    foreign = Signature("q", np.zeros(SIZE))  # another category's, whose betas are as long
    for signatures in ([foreign], [foreign, query(np.zeros(SIZE))]):
        with pytest.raises(InputError, match="prior"):
            index.add([Portion.of(signatures, entries(0, len(signatures)), 1, SIZE)])
    with only_one(folder, "another command"), pytest.raises(InputError, match="writing here already"):
        index.add(stream(1))
    assert len(LargeIndex.open(str(folder))) == 1000


def test_damaged_files_are_refused_and_never_read_beyond_their_end(tmp_path):
    LargeIndex.create(tmp_path, SPACE).add(stream(1000), "numbers")
    for path in sorted(tmp_path.iterdir()):
        whole = path.read_bytes()
        path.unlink()
        with pytest.raises(InputError):
            LargeIndex.open(tmp_path)
        for damaged in (b"", whole[: len(whole) // 2], whole[:-8]):
            path.write_bytes(damaged)
            with pytest.raises(InputError) as refusal:
                LargeIndex.open(tmp_path)
            assert "\n" not in str(refusal.value)
        path.write_bytes(whole)
    data = next(tmp_path.glob("lists-*.data"))
    data.write_bytes(b"?" * data.stat().st_size)  # its rows are nowhere
    with pytest.raises(InputError, match="damaged"):
        LargeIndex.open(tmp_path).search(query(np.zeros(SIZE)), 3)


def test_who_asks_while_another_adds_gets_an_answer(tmp_path, small_parts):
    """An open catalogue keeps answering from what was there, though its files may have been joined since."""
    writer = LargeIndex.create(tmp_path, SPACE)
    writer.add(stream(700), "numbers")
    reader = LargeIndex.open(tmp_path)
    writer.add(stream(5000, 700), "numbers")
    assert not any((tmp_path / f"{lists.name}.data").exists() for lists in reader.manifest.lists)
    assert reader.search(query(betas(5000)[50]), 1)[0].entry == entries(50, 51)[0]


def test_an_index_that_is_overtaken_as_it_is_opened_is_opened_as_it_is_then(tmp_path, small_parts):
    """Between what the manifest says and what is read of it files may go, again and again."""
    writer = LargeIndex.create(tmp_path, SPACE)
    writer.add(stream(700), "numbers")
    additions = [stream(5000, 700), stream(12000, 5000)]

    class Overtaken(LargeIndex):
        def _show(self, manifest: Manifest) -> None:
            if additions:
                writer.add(additions.pop(0), "numbers")
            super()._show(manifest)

    assert len(Overtaken.open(tmp_path)) == 12000


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="signals as POSIX has them")
def test_killed_at_any_moment_nothing_is_lost_or_doubled(tmp_path):
    """Whatever was there once is there for good; run to the end, it holds every entry once and nothing lies about."""
    folder, rng, before = tmp_path / "index", np.random.default_rng(0), 0
    for _ in range(6):
        process = warm().Process(target=add_slowly, args=(folder,))
        process.start()
        wait = time.monotonic() + 120
        while not (folder / "manifest.json").exists() or len(open_index(folder)) == before:
            assert process.is_alive()
            assert time.monotonic() < wait
            time.sleep(0.02)
        time.sleep(float(rng.uniform(0, 0.3)))
        process.kill()
        process.join()
        assert process.exitcode == -signal.SIGKILL
        index = open_index(folder)
        assert len(index) > before
        before = len(index)
        rows = rng.integers(before, size=20)
        assert [index.entry(int(row)) for row in rows] == [entries(row, row + 1)[0] for row in rows.tolist()]
    whole = warm().Process(target=add_slowly, args=(folder,))
    whole.start()
    whole.join(300)
    assert whole.exitcode == 0
    index = open_index(folder)
    assert len(index) == 20000
    everything = index.nearest(np.zeros((1, SIZE)), 20000).rows[0]
    assert len(set(everything[everything >= 0])) == (everything >= 0).sum()
    named = {"manifest.json", f"{index.manifest.centres}.npy"}
    named |= {f"{part.name}{end}" for part in index.manifest.parts for end in (".betas.npy", ".entries", ".ends.npy")}
    named |= {f"{lists.name}{end}" for lists in index.manifest.lists for end in (".data", ".sizes.npy")}
    assert files(folder) == named
    assert json.loads((folder / "manifest.json").read_text())["taken"] == [["numbers", 20000]]
