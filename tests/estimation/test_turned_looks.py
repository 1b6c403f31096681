"""Views that the network is unsure of, and those with improbable answers, are looked at from turned frames, too; no
other view, and only for the better."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.special import expit, logit

from helpers.categories import LAPTOP
from omad.data.procedural import generate
from omad.data.rendering.spoils.spoiling import spoilt
from omad.data.rendering.standard_views import observe_all, standard_view
from omad.data.source import load_views
from omad.estimation import estimator as module
from omad.estimation.estimate import Estimate
from omad.estimation.estimator import Estimator, EstimatorConfig
from omad.estimation.looks.improbable import LUCK, is_improbable, likelier, turned_frames
from omad.evaluation.robustness.experiment import scenes_from
from omad.evaluation.robustness.rows import ROWS


def expected_error(estimate: Estimate) -> float:
    """Of keypoints, geometric mean, category units."""
    return float(np.exp(np.log(estimate.keypoint_std / LAPTOP.metres_per_unit).mean()))


@pytest.mark.slow
def test_unsure_views_alone_change_and_become_surer(monkeypatch):
    laptop = Estimator.from_pretrained("laptop")
    row = ROWS["smooth-3"].spoil
    scenes = scenes_from(load_views("procedural", LAPTOP, 10, 40, 0, "off", "refuse"), LAPTOP, 0)
    views = [spoilt(scene, row).view for index in range(40) if (scene := scenes(index, row.staging)) is not None]
    seen = list(observe_all(views).values())
    after = laptop.first_answers(seen)
    sure = 0.95 * module.UNSURE  # the network rounds differently with others beside
    monkeypatch.setattr(module, "UNSURE", np.inf)
    before = laptop.first_answers(seen)
    changed = 0
    for once, again in zip(before, after, strict=True):
        if expected_error(once) <= sure:
            np.testing.assert_array_equal(again.keypoints, once.keypoints)
        if not np.array_equal(again.keypoints, once.keypoints):
            changed += 1
            assert expected_error(again) < expected_error(once)
    assert 0 < changed < 0.4 * len(seen)


@pytest.mark.slow
def test_improbable_answers_alone_are_compared_and_give_way_to_clearly_likelier_ones():
    dishwasher, row = Estimator.from_pretrained("dishwasher"), ROWS["around"].spoil
    category = dishwasher.category
    scenes = scenes_from(load_views("procedural", category, 10, 60, 0, "off", "refuse"), category, 0)
    views = [spoilt(scene, row).view for index in range(60) if (scene := scenes(index, row.staging)) is not None]
    seen = list(observe_all(views).values())
    before = dishwasher.first_answers(seen)
    after = dishwasher.reconsidered(seen, before)
    changed = 0
    for once, again in zip(before, after, strict=True):
        if not is_improbable(once):
            assert again is once
        elif not np.array_equal(again.keypoints, once.keypoints):
            changed += 1
            assert again.probability > once.probability
        if is_improbable(once):
            assert again.seconds["network"] > once.seconds["network"]
    assert 0 < changed < 0.4 * len(seen)
    fast = Estimator(dishwasher.net, EstimatorConfig.fast())
    assert fast.reconsidered(seen, before) == before


def test_other_answers_begin_a_quarter_round_to_either_side_and_half_round():
    view = standard_view(generate(LAPTOP, 0, "test"), LAPTOP, (0, 0))
    estimate = Estimator.from_pretrained("laptop")(view.observation())
    upright = estimate.T_camera_base[:3, 1]
    for quarters, frame in zip((1, -1, 2), turned_frames(estimate), strict=True):
        turn = Rotation.from_rotvec(quarters * np.pi / 2 * upright).as_matrix()
        np.testing.assert_allclose(frame[:3, :3], turn @ estimate.T_camera_base[:3, :3], atol=1e-6)
        np.testing.assert_allclose(frame[:3, 3], estimate.T_camera_base[:3, 3])
    from_all_around = replace(LAPTOP, views=replace(LAPTOP.views, azimuth=np.pi))
    assert len(turned_frames(replace(estimate, category=from_all_around))) == 2


def test_the_most_probable_counts_where_it_is_clearly_ahead_and_not_much_less_sure():
    view = standard_view(generate(LAPTOP, 0, "test"), LAPTOP, (0, 0))
    estimate = replace(Estimator.from_pretrained("laptop")(view.observation()), probability=0.5)

    def other(probability: float, less_sure: float) -> Estimate:
        return replace(estimate, probability=probability, keypoint_std=estimate.keypoint_std * less_sure)

    assert likelier(estimate, [other(0.7, 1.0)]).probability == 0.5
    chosen = likelier(estimate, [other(0.75, 1.0), other(0.9, 1.2), other(0.99, 2.0)])
    assert chosen.probability == pytest.approx(expit(logit(0.9) - LUCK))
    assert chosen.seconds == pytest.approx({key: 4 * value for key, value in estimate.seconds.items()})
    lost = replace(other(0.99, 1.0), keypoints=np.full_like(estimate.keypoints, np.nan))
    assert likelier(estimate, [lost]).probability == 0.5
    assert not is_improbable(replace(estimate, probability=None))
