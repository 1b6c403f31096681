"""Fitting confidence, on numbers whose distribution is known, and the views that it is fitted to."""

import re
import shutil
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import mannwhitneyu, norm

import omad
from helpers.categories import DRAWER, LAPTOP
from omad.cli.training.fitted import TrainConfidence, confidence_text
from omad.common.errors import InputError
from omad.data.procedural import generate
from omad.data.rendering.rasteriser import NOTHING
from omad.data.rendering.spoils.scenes import random_camera
from omad.data.rendering.spoils.spoil import Spoil
from omad.data.rendering.spoils.thinned import FEWEST, thinned_spoil
from omad.data.rendering.standard_views import standard_view
from omad.estimation.confidence.model import Confidence, FittedTo, deviations
from omad.estimation.confidence.signals import IMAGE, JOINT, WITHOUT_FRONT, WITHOUT_SURFACE, Signals
from omad.evaluation.calibration import area_under_roc, expected_calibration_error
from omad.evaluation.confidence import fitting, views
from omad.evaluation.confidence.fitting import JudgedAnswers, fit, measured
from omad.evaluation.confidence.views import HEAPS, OTHERS, examples
from omad.model.checkpoint import find_weights

VIEWS = 2000
TO_TEST = FittedTo("tests", VIEWS, "0")
BASE = 0.6, 2.0
"""How many times as far as by least squares its base is turned, and moved."""


def answers(
    seed: int, half_turned: float = 0.0, front: float = 0.0, surface: float = 0.0
) -> tuple[JudgedAnswers, np.ndarray]:
    """Answers whose errors are normal with a deviation that one signal tells, some of them ``half_turned`` where
    another one says so; and the true probabilities of being right, (N,), of which the ``front`` and the
    ``surface`` tell so much."""
    rng = np.random.default_rng(seed)
    image, joint = rng.normal(size=(VIEWS, len(IMAGE))), rng.normal(size=(VIEWS, 1, len(JOINT)))
    errors = np.abs(rng.normal(size=VIEWS)) * np.exp(-3 + 0.7 * joint[:, 0, 0])
    turned = (rng.random(VIEWS) < half_turned) & (image[:, 3] > 0)
    errors = np.where(turned, rng.uniform(1.0, 2.0, VIEWS), errors)
    likely = 1 / (
        1 + np.exp(-(0.5 + 2.0 * image[:, 1] + front * image[:, IMAGE.index("front")] + surface * image[:, -1]))
    )
    right, least = rng.random(VIEWS) < likely, np.full((VIEWS, 1), np.exp(-3))
    wider = np.exp(0.35 * joint[:, 0, :1])  # half of the way, in logarithms, that a joint's deviation is wider
    base = np.abs(rng.normal(size=(VIEWS, 6))) * wider * np.repeat(BASE, 3)
    return JudgedAnswers(Signals(image, joint, np.zeros((VIEWS, 4))), errors[:, None], right, base, least), likely


@pytest.fixture(scope="module")
def fitted() -> Confidence:
    return fit(answers(0)[0], LAPTOP, TO_TEST)


@pytest.fixture
def errors_alone(fitted: Confidence, monkeypatch: pytest.MonkeyPatch) -> None:
    """Fits have the probability of another, which takes most of their time."""
    monkeypatch.setattr(fitting, "fit_right", lambda answers, image: (fitted.right, 0.0))


def test_intervals_of_unseen_answers_hold_as_often_as_they_say(fitted: Confidence) -> None:
    unseen, _ = answers(1)
    std, tail = fitted.spreads(unseen.signals, LAPTOP)
    told = unseen.signals.joint[:, 0, 0]
    for some in (told < -0.5, np.abs(told) < 0.5, told > 0.5):
        for level in (0.5, 0.9):
            held = unseen.errors[some, 0] <= (std * deviations(level) ** tail)[some, 0]
            assert held.mean() == pytest.approx(level, abs=0.06)
    # the fit finds the deviations, and that the errors are normal
    assert np.log(std[:, 0]) == pytest.approx(-3 + 0.7 * told, abs=0.7)
    assert np.corrcoef(np.log(std[:, 0]), told)[0, 1] > 0.98
    assert np.median(tail) == pytest.approx(1, abs=0.15)


@pytest.mark.slow
def test_a_chance_of_a_half_turn_widens_the_upper_interval_alone(errors_alone: None) -> None:
    seen, _ = answers(0, half_turned=0.3)
    sure = fit(seen, LAPTOP, TO_TEST)
    unseen, _ = answers(1, half_turned=0.3)
    std, tail = sure.spreads(unseen.signals, LAPTOP)
    half = {level: (std * deviations(level) ** tail)[:, 0] for level in (0.5, 0.9)}
    may_turn = unseen.signals.image[:, 3] > 0.5
    assert np.median(half[0.9][may_turn]) > 0.7
    assert np.median(half[0.5][may_turn]) < 0.2
    assert np.median(half[0.9][unseen.signals.image[:, 3] < -0.5]) < 0.3
    assert (unseen.errors[may_turn, 0] <= half[0.9][may_turn]).mean() == pytest.approx(0.9, abs=0.06)


def test_probabilities_are_those_that_answers_were_drawn_with(fitted: Confidence) -> None:
    unseen, likely = answers(1)
    told = fitted.probabilities(unseen.signals)
    assert np.abs(told - likely).mean() < 0.05
    assert expected_calibration_error(told, unseen.right) < 0.05
    found = measured(fitted, unseen, LAPTOP)
    assert found["area_under_roc"] == pytest.approx(area_under_roc(likely, unseen.right), abs=0.02)
    assert found["right"] == unseen.right.mean()
    assert (found["covered_50"], found["covered_90"]) == pytest.approx((0.5, 0.9), abs=0.04)
    assert fitted.base == pytest.approx(BASE, rel=0.1)
    assert (found["rotation_covered_68"], found["translation_covered_68"]) == pytest.approx((0.68, 0.68), abs=0.04)


@pytest.mark.slow
def test_front_and_surface_are_asked_for_where_they_tell_right_from_wrong(
    fitted: Confidence, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert fitted.image == WITHOUT_FRONT
    monkeypatch.setattr(fitting, "DECAYS", fitting.DECAYS[1:2])  # a third of the fits
    monkeypatch.setattr(fitting, "fit_errors", lambda inputs, errors: fitted.errors)
    monkeypatch.setattr(fitting, "base_multiples", lambda *_: fitted.base)
    for telling, asked in (({"front": 1.0}, WITHOUT_SURFACE), ({"surface": 1.0}, IMAGE)):
        asking = fit(answers(0, **telling)[0], LAPTOP, TO_TEST)
        assert asking.image == asked
        unseen, likely = answers(1, **telling)
        assert np.abs(asking.probabilities(unseen.signals) - likely).mean() < 0.05


@pytest.mark.slow
def test_other_things_count_for_the_probability_alone(errors_alone: None) -> None:
    seen, _ = answers(0)
    other = np.arange(VIEWS) % 4 == 0
    seen = replace(seen, errors=np.where(other[:, None], np.nan, seen.errors), right=seen.right & ~other)
    assert fit(seen, LAPTOP, TO_TEST).errors(np.zeros(len(WITHOUT_FRONT) + len(JOINT) + 1))[0] == pytest.approx(
        -3 + np.log(norm.isf(0.25)), abs=0.2
    )
    few = replace(seen, errors=np.where(np.arange(VIEWS)[:, None] < 100, seen.errors, np.nan))
    with pytest.raises(InputError, match=r"views: 75 of them .* give more"):
        fit(few, LAPTOP, TO_TEST)


def test_too_few_views_are_refused_before_any_is_made(monkeypatch: pytest.MonkeyPatch) -> None:
    for made in ("load_models", "fit_hand"):  # the hand is learned first
        monkeypatch.setattr(f"omad.cli.training.fitted.{made}", None)
    with pytest.raises(InputError, match=r"views: are 199, .* at least 200 .* give more"):
        TrainConfidence(category="microwave", views=199).run()
    with pytest.raises(InputError, match="from 306 on"):  # enough only if all of them showed it
        TrainConfidence(category="microwave", views=305).run()
    fitting.check_views(306)


@pytest.mark.parametrize(("left_out", "asked"), [("", IMAGE), ("surfaces.npz", WITHOUT_SURFACE)])
def test_it_is_learned_from_surfaces_where_they_lie_beside(
    left_out: str, asked: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = list[tuple[str, ...]]()

    def answered(estimator: omad.Estimator, *_: object) -> JudgedAnswers:
        seen.append(tuple(estimator.answers.asked))
        raise InterruptedError

    folder = shutil.copytree(find_weights("laptop"), tmp_path / "laptop", ignore=shutil.ignore_patterns(left_out))
    monkeypatch.setattr(fitting, "answered", answered)
    with pytest.raises(InterruptedError):
        TrainConfidence(category="laptop", weights=folder, objects=1, views=306).run()
    assert seen == [asked]


def test_a_person_is_told_what_was_promised_and_what_was_measured(fitted: Confidence) -> None:
    record = fitting.measured(fitted, answers(1)[0], LAPTOP)
    lines = confidence_text(
        {"checkpoint": "run", "views": VIEWS, "asks_front": False, "asks_surface": True} | record
    ).splitlines()
    assert re.fullmatch(r"joint states in their 90 % interval +90% +\d+%", lines[4])
    assert lines[-1] == "asks what the front looks like: no; asks what the surface explains: yes"


def test_a_fit_can_be_kept(fitted: Confidence, tmp_path: Path) -> None:
    (tmp_path / "model.safetensors").write_bytes(b"weights")
    fitted.save(tmp_path)
    assert Confidence.load(tmp_path, LAPTOP) == fitted
    assert (tmp_path / "confidence.json").stat().st_size < 100_000


def test_calibration_error_and_area_of_closed_forms() -> None:
    told, right = np.array([0.95, 0.95, 0.15, 0.15, 1.0]), np.array([True, False, False, False, True])
    assert expected_calibration_error(told, right) == pytest.approx((abs(0.95 * 2 + 1 - 2) + 0.3) / 5)
    rng = np.random.default_rng(0)
    told, right = rng.integers(0, 20, 500) / 20, rng.random(500) < 0.4
    expected = mannwhitneyu(told[right], told[~right]).statistic / (right.sum() * (~right).sum())
    assert area_under_roc(told, right) == pytest.approx(expected)
    assert np.isnan(area_under_roc(told, np.ones(500, dtype=bool)))
    drawn = rng.random(100_000)
    assert expected_calibration_error(drawn, rng.random(100_000) < drawn) < 0.01


def test_training_views_are_repeatable_and_of_many_kinds() -> None:
    models = [generate(LAPTOP, index, "train", 1) for index in range(3)]
    shown = list(examples(models, LAPTOP, range(12), 0))
    again = list(examples(models, LAPTOP, range(12), 0))
    for one, other in zip(shown, again, strict=True):
        assert np.array_equal(one.view.depth, other.view.depth)
        assert np.array_equal(one.observation().points, other.observation().points)
    whole = [len(one.view.observation().points) for one in shown]
    seen = [len(one.observation().points) for one in shown]
    assert all(FEWEST <= few <= all_of for few, all_of in zip(seen, whole, strict=True))
    assert 0 < sum(few < all_of for few, all_of in zip(seen, whole, strict=True)) < len(shown) / 2
    kinds = Counter(example.of_category for example in shown)
    assert kinds[True] > kinds[False] > 0
    assert 0 < HEAPS < OTHERS < 0.5
    assert all(example.view.truth.name in {model.name for model in models} for example in shown if example.of_category)


def test_masks_that_leave_a_part_out_count_for_the_probability_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(views, "PART_MISSED", 1.0)
    models = [generate(LAPTOP, index, "test") for index in range(3)]
    found = fitting.answered(omad.Estimator.from_pretrained("laptop", "cpu"), models, 12, 0)
    assert not found.counted.any()
    assert len(found.right) == 12
    shown = [one for one in examples(models, LAPTOP, range(12), 0) if one.of_category]
    parts = [np.unique(one.view.labels[one.view.mask & (one.view.labels != NOTHING)]) for one in shown]
    assert all(one.part_missed for one in shown)
    assert any(len(those) == 1 for those in parts)  # a wider mask takes in some of what was left out


def test_spoils_are_from_none_to_all() -> None:
    rng = np.random.default_rng(0)
    counts = [sum(v != d for v, d in zip(vars(thinned_spoil(rng)).values(), vars(Spoil()).values(), strict=True))
              for _ in range(200)]  # fmt: skip
    assert min(counts) == 0
    assert max(counts) >= 6
    assert 1 < np.mean(counts) < 5


def test_a_stretched_object_is_stretched_along_with_its_joints() -> None:
    model, factors = generate(DRAWER, 0, "train", 1), np.array([1.5, 0.8, 1.2])
    longer = model.stretched(factors)
    assert longer.part_boxes() == pytest.approx(model.part_boxes() * factors)
    assert longer.axes == pytest.approx(model.axes)
    assert longer.limits == pytest.approx(model.limits * 1.2)  # along z
    states = 0.5 * model.limits.sum(1)
    for part, (one, other) in enumerate(
        zip(model.posed_vertices(states), longer.posed_vertices(states * 1.2), strict=True)
    ):
        assert other == pytest.approx(one * factors), part
    laptop = generate(LAPTOP, 0, "train", 1)
    assert laptop.stretched(factors).limits == pytest.approx(laptop.limits)
    assert laptop.stretched(factors).pivots == pytest.approx(laptop.pivots * factors)


def test_an_object_is_seen_by_every_camera_stretched_or_not(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is shown is drawn apart from how it is seen."""
    models, shown = [generate(LAPTOP, index) for index in range(6)], Counter[tuple[str, bool, bool]]()

    def seen(model, category, seed, staging):
        rng = np.random.default_rng(list(seed))
        rng.integers(2**62)  # as draw_scene begins
        camera = random_camera(rng)
        if category is LAPTOP:
            plain = any(model.parts is one.parts for one in models)
            shown[model.name, plain, camera.width > 600] += 1
        raise InputError("enough")

    monkeypatch.setattr(views, "draw_scene", seen)
    for index in range(500):
        assert views._example(models, LAPTOP, (0, index)) is None
    assert len(shown) == len(models) * 2 * 2


def test_views_to_learn_from_are_not_those_to_measure_on():
    model = generate(LAPTOP, 0)
    seen = [one.view for one in examples([model], LAPTOP, range(4), seed=0) if one.of_category]
    measured_on = [standard_view(model, LAPTOP, (*view.seed[:2], 0)) for view in seen]
    assert seen
    assert not any(np.allclose(a.states, b.states) for a, b in zip(seen, measured_on, strict=True))
