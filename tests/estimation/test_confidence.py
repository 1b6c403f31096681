"""Confidence: intervals against SciPy's distributions, the file against what was put into it, signals against torch."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.stats import norm

import omad
from helpers.categories import DRAWER, LAPTOP
from helpers.confidences import always, constant
from omad.common.errors import InputError
from omad.data.procedural import generate
from omad.data.rendering.standard_views import standard_view
from omad.estimation.checks import Check, is_doubtful
from omad.estimation.confidence.model import FILE, Confidence
from omad.estimation.confidence.perceptron import Perceptron
from omad.estimation.confidence.signals import IMAGE, JOINT, WITHOUT_FRONT, Signals, _trace_between, cut_off
from omad.estimation.estimate import Estimate
from omad.estimation.evidence import explanation
from omad.geometry.transforms import quaternion_to_matrix
from omad.model.checkpoint import find_weights
from omad.model.fronts.network import shipped_front_net
from omad.model.fronts.seen import front_of
from omad.sensing.observation import Observation


def observed(index: int = 0) -> Observation:
    return standard_view(generate(LAPTOP, index, "test"), LAPTOP, (0, index)).observation()


@pytest.fixture(scope="module")
def plain() -> omad.Estimator:
    """Without confidence."""
    estimator = omad.Estimator.from_pretrained("laptop", "cpu")
    return omad.Estimator(estimator.net, estimator.config)


@pytest.fixture(scope="module")
def estimate(plain: omad.Estimator) -> Estimate:
    return plain(observed())


@pytest.fixture
def checkpoint(tmp_path: Path) -> Path:
    """A copy of the laptop's, without confidence."""
    for name in ("config.json", "model.safetensors"):
        shutil.copy(find_weights("laptop") / name, tmp_path / name)
    return tmp_path


def signals(batch: int, joints: int, seed: int = 0) -> Signals:
    rng = np.random.default_rng(seed)
    return Signals(
        rng.normal(size=(batch, len(IMAGE))), rng.normal(size=(batch, joints, len(JOINT))), rng.normal(size=(batch, 4))
    )


def test_without_confidence_answers_are_the_least_squares_own(estimate: Estimate) -> None:
    [joint] = estimate.joints
    assert joint.state_std == np.sqrt(estimate.covariance[6, 6])
    assert estimate.base_std == pytest.approx(np.sqrt(estimate.covariance.diagonal()[:6]))
    assert (estimate.probability, estimate.doubtful) == (None, None)
    for level in (0.1, 0.5, 0.9, 0.99):
        assert joint.interval(level) == pytest.approx(norm.interval(level, joint.state, joint.state_std))
    record = estimate.to_dict()
    assert (record["probability"], record["doubtful"]) == (None, None)
    assert record["joints"][0]["interval_90"] == pytest.approx(joint.interval(0.9))
    assert record["initial"]["joints"][0]["interval_90"] is None


def test_a_joint_is_json_and_levels_may_be_tensors(estimate: Estimate) -> None:
    [joint] = estimate.joints
    told = json.loads(json.dumps(joint.to_dict()))
    assert told["axis"] == joint.axis.tolist()
    assert told["interval_90"] == list(joint.interval(0.9))
    for level in (np.float64(0.9), np.array(0.9), torch.tensor(0.9, dtype=torch.float64, requires_grad=True)):
        assert joint.interval(level) == joint.interval(0.9)


@pytest.mark.parametrize("level", [0.0, 1.0, -0.5, 90.0, float("nan"), "a"])
def test_an_interval_is_of_a_probability(estimate: Estimate, level: float) -> None:
    with pytest.raises(InputError, match=r"level: .* give 0\.9"):
        estimate.joints[0].interval(level)


@pytest.mark.parametrize("tail", [0.6, 1.0, 2.5])
def test_intervals_hold_powers_of_normal_numbers(estimate: Estimate, tail: float) -> None:
    joint = replace(estimate.joints[0], state_std=0.3, tail=tail)
    drawn = np.random.default_rng(0).normal(size=200_000)
    truth = joint.state + joint.state_std * np.sign(drawn) * np.abs(drawn) ** tail
    for level in (0.5, 0.68, 0.9, 0.99):
        low, high = joint.interval(level)
        assert ((low <= truth) & (truth <= high)).mean() == pytest.approx(level, abs=0.005)
    low, high = joint.interval(np.nextafter(1.0, 0.0))  # is still one
    assert joint.interval(0.999)[1] < high < np.inf


def test_confidence_says_how_wide_intervals_are_in_metres_and_radians(plain: omad.Estimator) -> None:
    surely = always(LAPTOP, 0.02, 0.11, 0.3)
    estimate = omad.Estimator(plain.net, plain.config, confidence=surely)(observed())
    [joint] = estimate.joints
    assert np.diff(joint.interval(0.5))[0] / 2 == pytest.approx(0.02)
    assert np.diff(joint.interval(0.9))[0] / 2 == pytest.approx(0.11)
    assert estimate.probability == pytest.approx(0.3)
    assert estimate.doubtful is True
    std, tail = always(DRAWER, 0.02, 0.11, 0.3).spreads(signals(4, 3), DRAWER)
    assert std * norm.isf(0.25) ** tail == pytest.approx(np.full((4, 3), 0.02 * DRAWER.metres_per_unit))


def test_a_state_that_is_known_stays_known(plain: omad.Estimator) -> None:
    estimator = omad.Estimator(plain.net, plain.config, confidence=always(LAPTOP, 0.02, 0.11, 0.9))
    assert estimator(observed(), omad.Known(joint_states=np.array([0.3]))).joints[0].state_std == 0


def test_no_interval_is_wider_than_the_joint_travels() -> None:
    std, _ = always(LAPTOP, 50.0, 60.0, 0.5).spreads(signals(2, 1), LAPTOP)
    assert std == pytest.approx(np.full((2, 1), np.ptp(LAPTOP.metric_limits)))


def test_signals_are_finite_and_the_same_in_a_batch(plain: omad.Estimator) -> None:
    views = [observed(index) for index in range(3)]
    together = plain(views)
    for view, one in zip(views, together, strict=True):
        alone = plain(view).signals
        assert np.isfinite(alone.image).all()
        assert np.isfinite(alone.joint).all()
        assert one.signals.image == pytest.approx(alone.image, abs=0.1)
        assert one.signals.joint == pytest.approx(alone.joint, abs=0.1)
    told = dict(zip(IMAGE, together[0].signals.image[0], strict=True))
    assert told["points"] == pytest.approx(np.log(len(views[0].points)))
    assert told["expected error"] == pytest.approx(np.log(together[0].keypoint_std / LAPTOP.metres_per_unit).mean())
    assert told["residual"] == pytest.approx(np.log(together[0].residual / LAPTOP.metres_per_unit + 1e-3))
    assert told["distance"] == pytest.approx(
        np.log(np.linalg.norm(together[0].T_camera_base[:3, 3]) / LAPTOP.metres_per_unit + 1e-3)
    )


def test_borders_are_as_long_in_large_images_as_in_small_ones() -> None:
    for size, every in ((300, 1), (1500, 2)):
        depth = np.ones((size, 2 * size), np.float32)
        seen = omad.Observation.from_depth(depth, (size, size, size, size / 2))
        assert seen.every == every
        assert cut_off(seen) == pytest.approx({"left": 0.5**0.5, "right": 0.5**0.5, "top": 2**0.5, "bottom": 2**0.5})


def test_the_front_is_looked_at_only_where_it_is_asked_for(plain: omad.Estimator) -> None:
    asking = omad.Estimator(plain.net, plain.config, confidence=always(LAPTOP, 0.02, 0.11, 0.9))
    size = len(WITHOUT_FRONT) + len(JOINT)
    without = {"right": constant(size, [0.0]), "errors": constant(size + 1, [-3.0, 1.0])}
    before = replace(always(LAPTOP, 0.02, 0.11, 0.3), image=WITHOUT_FRONT, **without)
    seen, unseen = asking(observed()), omad.Estimator(plain.net, plain.config, confidence=before)(observed())
    assert unseen.probability == 0.5
    front = IMAGE.index("front")
    assert (seen.signals.image[0, :front] == unseen.signals.image[0, :front]).all()
    assert unseen.signals.image[0, front] == 0
    assert (seen.signals.image[0, front + 1 :] == 0).all()
    image = front_of(seen, LAPTOP, seen.labelled.points)[None]
    told = np.exp(shipped_front_net().says(image)[0, shipped_front_net().names.index("laptop")])
    assert seen.signals.image[0, front] == pytest.approx(np.log(told / (1 - told)), rel=1e-6)
    assert (shipped_front_net().odds(image, "kite") == 0).all()


def test_the_surface_is_held_against_what_was_seen_only_where_it_is_asked_for(plain: omad.Estimator) -> None:
    size, surfaces = len(IMAGE) + len(JOINT), omad.Estimator.from_pretrained("laptop", "cpu").surfaces
    with_surface = {"image": IMAGE, "right": constant(size, [0.0]), "errors": constant(size + 1, [-3.0, 1.0])}
    asks = replace(always(LAPTOP, 0.02, 0.11, 0.9), **with_surface)
    asking = omad.Estimator(plain.net, plain.config, confidence=asks, surfaces=surfaces)
    estimate = asking(observed())
    known = explanation(observed(), estimate)
    shares = dict(zip(IMAGE, estimate.signals.image[0], strict=True))
    for name, share in (("in front", known.in_front), ("behind", known.behind), ("missing", known.missing)):
        assert shares[f"surface {name}"] == pytest.approx(share, abs=0.04), name
    with pytest.raises(InputError, match=r"laptop: its confidence\.json asks for surfaces\.npz, .* run omad"):
        omad.Estimator(plain.net, plain.config, confidence=asks)


def test_signals_see_a_worse_view(plain: omad.Estimator) -> None:
    view = observed()
    cut = Observation.from_depth(
        view.depth, view.camera, box=(0, 0, int(np.median(view.pixels[:, 0])), view.camera.height)
    )
    names = dict(zip(IMAGE, np.stack([plain(one).signals.image[0] for one in (view, cut)], 1), strict=True))
    for name in ("expected error", "spread"):
        good, bad = names[name]
        assert bad > good, name
    assert names["points"][1] < names["points"][0]


def test_the_angle_to_a_quaternion_is_that_to_its_matrix() -> None:
    generator = torch.Generator().manual_seed(0)
    a, b = torch.nn.functional.normalize(torch.randn(2, 9, 4, dtype=torch.float64, generator=generator), dim=2)
    expected = (quaternion_to_matrix(a) * quaternion_to_matrix(b)).sum((1, 2))
    assert _trace_between(a.numpy(), quaternion_to_matrix(b).numpy()) == pytest.approx(expected.numpy())


def test_a_perceptron_is_the_network_that_it_says() -> None:
    generator = torch.Generator().manual_seed(0)
    hidden, bent, straight = (
        torch.randn(shape, dtype=torch.float64, generator=generator) for shape in ((5, 4), (2, 5), (2, 4))
    )
    mean, spread = (1.0, -2.0, 0.5), (2.0, 0.5, 1.0)
    rows = [tuple(map(tuple, weights.tolist())) for weights in (hidden, bent, straight)]
    x = torch.randn(7, 3, dtype=torch.float64, generator=generator)
    scaled = ((x - torch.tensor(mean)) / torch.tensor(spread)).clamp(-4, 4)
    inner = torch.nn.functional.linear(scaled, hidden[:, :3], hidden[:, 3]).tanh()
    expected = inner @ bent.T + torch.nn.functional.linear(scaled, straight[:, :3], straight[:, 3])
    assert Perceptron(mean, spread, *rows)(x.numpy()) == pytest.approx(expected.numpy())


def test_the_file_says_what_was_put_into_it(checkpoint: Path) -> None:
    assert Confidence.load(checkpoint, LAPTOP) is None
    surely = always(LAPTOP, 0.02, 0.11, 0.8)
    surely.save(checkpoint)
    assert Confidence.load(checkpoint, LAPTOP) == surely
    estimate = omad.Estimator.from_pretrained(checkpoint, "cpu")(observed())
    assert estimate.probability == pytest.approx(0.8)
    assert json.loads(estimate.to_json())["probability"] == estimate.probability


def test_the_base_is_as_sure_as_the_joints_and_was_measured(plain: omad.Estimator) -> None:
    told = replace(always(LAPTOP, 0.02, 0.11, 0.8), base=(2.0, 3.0))
    estimate = omad.Estimator(plain.net, plain.config, confidence=told)(observed())
    least = np.sqrt(estimate.covariance.diagonal())
    wider = np.sqrt(estimate.joints[0].state_std / least[6])
    assert wider != pytest.approx(1, abs=0.05)
    assert estimate.base_std == pytest.approx(least[:6] * wider * [2, 2, 2, 3, 3, 3])
    assert estimate.to_dict()["base_std"] == estimate.base_std.tolist()


@pytest.mark.parametrize(
    ("damage", "told"),
    [
        (lambda text: text[: len(text) // 2], "not readable as JSON"),
        (lambda text: "[]", "not a confidence"),
        (lambda text: text.replace('"format": 1', '"format": 7'), "format 1"),
        (lambda text: text.replace('"right"', '"left"'), "left: is unknown"),
        (lambda text: text.replace('"mean": [0.0, ', '"mean": [', 1), "errors.*rows of"),
        (lambda text: text.replace('"mean": [0.0, ', '"mean": ["x", ', 1), r"errors\.mean\[0\]: is 'x'"),
        (lambda text: text.replace('"laptop"', '"drawer"'), "is for drawer, not for laptop"),
        (lambda text: text.replace('"misfit"', '"mischief"'), "of another version"),
        (lambda text: text.replace('"weights": "', '"weights": "0'), "other weights"),
        (lambda text: text.replace('"shared": 0.5', '"shared": 1.5'), "shared is 1.5"),
        (lambda text: text.replace('"base": [1.0, ', '"base": [-1.0, '), r"base is \(-1.0, 1.0\)"),
    ],
)
def test_a_damaged_file_is_refused(checkpoint: Path, damage, told: str) -> None:
    always(LAPTOP, 0.02, 0.11, 0.8).save(checkpoint)
    path = checkpoint / FILE
    record = json.loads(path.read_text())
    del record["sha256"]  # as earlier versions wrote it, or a hand that knows what it does
    path.write_text(damage(json.dumps(record)))
    with pytest.raises(InputError, match=told) as raised:
        omad.Estimator.from_pretrained(checkpoint, "cpu")
    assert str(path) in str(raised.value)
    assert "omad train confidence" in str(raised.value)


def test_a_turned_bit_is_told_by_the_checksum(checkpoint: Path) -> None:
    always(LAPTOP, 0.02, 0.11, 0.8).save(checkpoint)
    path = checkpoint / FILE
    path.write_text(path.read_text().replace("0.0", "0.1", 1))
    with pytest.raises(InputError, match=r"confidence\.json: is damaged.*checksum"):
        omad.Estimator.from_pretrained(checkpoint, "cpu")


def test_an_answer_is_doubtful_by_its_probability_and_else_by_its_checks(estimate: Estimate) -> None:
    check = Check("size", "", "", "")
    assert is_doubtful(estimate, [check])
    assert not is_doubtful(estimate, [])
    assert not is_doubtful(replace(estimate, probability=0.6), [check])
    assert is_doubtful(replace(estimate, probability=0.4), [])


def test_several_views_say_together_how_sure_they_are(plain: omad.Estimator) -> None:
    estimator = omad.Estimator(plain.net, plain.config, confidence=always(LAPTOP, 0.02, 0.11, 0.8))
    view = observed()
    first, second = estimator([view, view], T_world_camera=np.stack([np.eye(4)] * 2))
    assert first.probability == second.probability == pytest.approx(0.8)
    assert first.joints[0].interval(0.9) == pytest.approx(second.joints[0].interval(0.9))
    assert np.diff(first.joints[0].interval(0.9))[0] / 2 == pytest.approx(0.11)
