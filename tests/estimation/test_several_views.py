"""Several views of one object, fitted together: one answer, in every camera's frame, that is worth what they tell."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

import omad
from omad.data.procedural import generate
from omad.data.rendering.depth_noise import LEVELS
from omad.data.rendering.standard_views import View, standard_view, views_together
from omad.estimation import estimator as module
from omad.estimation.estimator import Estimator
from omad.estimation.several_views import CONTRADICTS, SAME_SLIDE, Rig, contradictions
from omad.geometry.rigid import carry, rigid, turned_about
from omad.model.fitting.energy import RefinementConfig
from omad.model.fitting.refinement import Refiner
from omad.model.fitting.state import State, Targets

ELSEWHERE = rigid(Rotation.from_rotvec([0.3, -1.0, 0.4]).as_matrix(), [5.0, -2.0, 1.0])


@pytest.fixture(scope="module")
def estimator() -> Estimator:
    return Estimator.from_pretrained("laptop", device="cpu")


@pytest.fixture(scope="module")
def views(estimator) -> list[View]:
    return moment(estimator, 0, 3)


def moment(estimator: Estimator, index: int, count: int) -> list[View]:
    category = estimator.category
    return views_together(generate(category, index, "test", 23), category, (31, index), count, LEVELS["on"])


def observed(views: list[View]) -> tuple[list[omad.Observation], np.ndarray]:
    """Observations, and where their cameras are."""
    return [view.observation() for view in views], np.linalg.inv([view.T_camera_base for view in views])


def test_views_of_a_moment_show_one_object(views):
    """Of every view, all seen points lie in the box of the object as the first view has it."""
    model = generate(omad.get_category("laptop"), 0, "test", 23)
    vertices = np.concatenate(model.posed_vertices(views[0].states))
    for view in views:
        assert (view.states == views[0].states).all()
        rows, columns = np.nonzero(view.labels != 255)
        seen = view.camera.backproject(np.stack([columns, rows], 1), view.depth[rows, columns].astype(float))
        seen = carry(np.linalg.inv(view.T_camera_base), seen)
        share = ((seen > vertices.min(0) - 0.02) & (seen < vertices.max(0) + 0.02)).all(1).mean()
        assert share > 0.98
    assert np.linalg.norm(views[0].T_camera_base - views[1].T_camera_base) > 0.1


def test_one_view_gives_what_it_gives_alone(estimator, views):
    [observation], T = observed(views[:1])
    alone, [one] = estimator(observation), estimator([observation], T_world_camera=T)
    assert np.abs(alone.keypoints - one.keypoints).max() < 1e-6
    assert np.abs(alone.joint_states - one.joint_states).max() < 1e-6
    assert np.abs(alone.covariance - one.covariance).max() < 1e-6
    assert alone.warnings == one.warnings


def test_one_view_with_an_improbable_answer_is_compared_with_others_too(estimator, views, monkeypatch):
    monkeypatch.setattr(module, "is_improbable", lambda estimate: True)
    monkeypatch.setattr(module, "likelier", lambda estimate, others: others[-1])
    [observation], T = observed(views[:1])
    alone, [one] = estimator(observation), estimator([observation], T_world_camera=T)
    assert np.array_equal(alone.keypoints, one.keypoints)


@pytest.mark.parametrize("lost", [0, 2])
def test_a_view_without_numbers_leaves_the_others_their_answer(lost):
    """Of three views that see the same, and say the same but for one."""
    place, keypoints = torch.eye(4).repeat(3, 1, 1), torch.randn(3, 5, 3, generator=torch.Generator().manual_seed(0))
    place[:, :3, 3] = torch.tensor([[0.0, 0.0, -3.0], [1.0, 0.0, -3.0], [2.0, 0.0, -3.0]])
    keypoints = 0.1 * keypoints[:1].repeat(3, 1, 1)
    seen, weights = keypoints.clone(), torch.ones(3, 5)
    keypoints[1 if lost else 2] += 0.01
    for broken in (keypoints, seen, weights):
        broken[lost] = torch.nan
    rig = Rig(place, torch.ones(3, 3, dtype=torch.bool), 0.5)
    best, targets = rig.together(Targets(seen, weights), keypoints)
    assert best.item() == (0 if lost else 1)
    told = targets.weights.view(5, 3)  # every keypoint once a view in turn
    assert (told[:, lost] == 0).all()
    assert (told[:, [view for view in range(3) if view != lost]] > 0).all()


def test_one_answer_in_every_cameras_frame(estimator, views):
    observations, T = observed(views)
    found = estimator(observations, T_world_camera=T)
    assert len(found) == 3
    first = found[0]
    for estimate, T_world, observation in zip(found, T, observations, strict=True):
        assert np.allclose(estimate.joint_states, first.joint_states)
        assert np.allclose(estimate.beta, first.beta)
        assert np.allclose(carry(T_world, estimate.keypoints), carry(T[0], first.keypoints), atol=1e-5)
        assert len(estimate.part_labels) == len(observation.points)
        R = (np.linalg.inv(T_world) @ T[0])[:3, :3]
        for block in (slice(3), slice(3, 6)):
            assert np.allclose(estimate.covariance[block, block], R @ first.covariance[block, block] @ R.T, atol=1e-6)
            wide, first_wide = (np.linalg.norm(each.base_std[block]) for each in (estimate, first))
            assert wide == pytest.approx(first_wide, rel=1e-4)  # whatever the camera's axes
        assert np.allclose(estimate.covariance[6:, 6:], first.covariance[6:, 6:])


def test_only_where_cameras_are_to_each_other_matters(estimator, views):
    observations, T = observed(views)
    for one, other in zip(
        estimator(observations, T_world_camera=T), estimator(observations, T_world_camera=ELSEWHERE @ T), strict=True
    ):
        assert np.abs(one.keypoints - other.keypoints).max() < 0.1 * one.keypoint_std.min()
        assert np.allclose(one.joint_states, other.joint_states, atol=2e-3)


def test_a_view_that_is_given_twice_counts_once(estimator, views):
    [observation], [T] = observed(views[:1])
    alone, twice = estimator(observation), estimator([observation] * 2, T_world_camera=np.stack([T] * 2))[0]
    assert np.abs(alone.keypoints - twice.keypoints).max() < 0.1 * alone.keypoint_std.min()
    assert np.allclose(twice.joints[0].state_std, alone.joints[0].state_std, rtol=0.05)


def test_other_sides_make_it_surer(estimator):
    alone, together = [], []
    for index in range(8):
        observations, T = observed(moment(estimator, index, 3))
        alone.append([estimate.joints[0].state_std for estimate in estimator(observations)])
        together.append(estimator(observations, T_world_camera=T)[0].joints[0].state_std)
    assert np.mean(together) < np.mean(alone)
    assert np.mean(together) > np.mean(np.min(alone, axis=1)) / np.sqrt(3)


def test_what_is_of_the_object_no_further_view_tells(estimator, views, monkeypatch):
    observations, T = observed(views)
    told = []
    for shared in (0.0, 0.5, 1.0):
        monkeypatch.setattr(estimator.answers, "shared", shared)
        found = estimator(observations, T_world_camera=T)[0]
        told.append((found.joints[0].state_std, np.sqrt(found.covariance[6, 6])))
    less, half, none = np.array(told)
    assert (less < 0.95 * half).all()
    assert (half < 0.95 * none).all()


def test_a_view_from_elsewhere_is_left_out_and_named(estimator, views):
    observations, T = observed(views)
    pair = estimator(observations[:2], T_world_camera=T[:2])
    middle = observations[2].points.mean(0)
    T[2] = T[2] @ turned_about(Rotation.from_rotvec([0, 0, 2.0]).as_matrix(), middle)
    found = estimator(observations, T_world_camera=T)
    of_third = [warning for warning in found[0].warnings if warning.startswith("view 3: ")]
    assert of_third[0].startswith("view 3: views: ")
    assert of_third[1:] == [f"view 3: {warning}" for warning in estimator(observations[2]).warnings]
    assert np.abs(found[0].keypoints - pair[0].keypoints).max() < 0.2 * pair[0].keypoint_std.min()
    assert np.allclose(found[0].joints[0].state_std, pair[0].joints[0].state_std, rtol=0.05)


def moved(estimator: Estimator, index: int, count: int) -> tuple[list[omad.Observation], np.ndarray, list[View]]:
    """Views of a moment, before the last of which the lid has moved by 40 degrees."""
    category, views = estimator.category, moment(estimator, index, count)
    model, first = generate(category, index, "test", 23), views[0].states
    states = first - np.sign(first) * np.radians(40)
    views[-1] = standard_view(model, category, (31, index, count - 1), LEVELS["on"], states)
    return *observed(views), views


def test_a_joint_that_moved_between_two_views_is_told_and_both_are_doubtful(estimator):
    for index in range(3):
        observations, T, _ = moved(estimator, index, 2)
        found = estimator(observations, T_world_camera=T)
        assert [warning for warning in found[0].warnings if ": joints: alone it says hinge" in warning]
        assert all(estimate.doubtful for estimate in found)


def test_of_three_views_the_one_before_which_a_joint_moved_is_left_out(estimator):
    observations, T, views = moved(estimator, 0, 3)
    found, pair = estimator(observations, T_world_camera=T), estimator(observations[:2], T_world_camera=T[:2])
    [told] = [warning for warning in found[0].warnings if "joints: " in warning]
    assert told.startswith("view 3: joints")
    assert f"the answer to all views is {found[0].joints[0]}" in told
    assert found[0].joint_states == pytest.approx(pair[0].joint_states, abs=np.radians(1))
    assert found[0].joint_states == pytest.approx(views[0].states, abs=np.radians(5))
    assert [estimate.doubtful for estimate in found] == [False, False, True]


@pytest.mark.parametrize("name", ["laptop", "eyeglasses"])
def test_views_that_agree_are_not_doubted(name):
    estimator = Estimator.from_pretrained(name, device="cpu")
    for index in range(6):
        observations, T = observed(moment(estimator, index, 3))
        for estimate in estimator(observations, T_world_camera=T):
            assert not [warning for warning in estimate.warnings if "views: " in warning or "joints: " in warning]
            assert [joint.name for joint in estimate.joints_alone] == [joint.name for joint in estimate.joints]


@pytest.mark.parametrize("name", ["drawer", "stapler"])
def test_views_contradict_an_answer_beyond_shares_of_the_unit(name):
    category = omad.get_category(name)
    view = standard_view(generate(category, 3, "test"), category, (1, 3))
    estimate, unit = Estimator.from_pretrained(name, device="cpu")(view.observation()), category.metres_per_unit
    for shift, told in ((0.9, []), (1.1, ["views"])):
        aside = estimate.keypoints + [shift * CONTRADICTS * unit, 0, 0]
        found = replace(estimate, joints_alone=estimate.joints, observed_keypoints=aside)
        assert [check.name for check in contradictions(found)] == told
    if name == "drawer":
        here = replace(estimate, observed_keypoints=estimate.keypoints)
        for travel, told in ((0.9, []), (1.1, ["joints"])):
            first, *rest = (replace(joint, state_std=1e-6) for joint in estimate.joints)
            alone = replace(first, state=first.state + travel * SAME_SLIDE * unit)
            found = replace(here, joints_alone=(alone, *rest))
            assert [check.name for check in contradictions(found)] == told


def test_what_is_no_such_object_still_gets_an_answer(estimator):
    ball = np.random.default_rng(0).normal(size=(2, 3000, 3))
    ball = 0.05 * ball / np.linalg.norm(ball, axis=2, keepdims=True) + [0, 0, 1.0]
    apart = np.stack([np.eye(4), rigid(np.eye(3), [0.0, 0.0, 3.0])])
    for estimate in estimator([omad.Observation.from_points(points) for points in ball], T_world_camera=apart):
        assert np.isfinite(estimate.keypoints).all()
        assert np.isfinite(estimate.covariance).all()
        assert estimate.warnings


def test_gravity_is_the_first_cameras(estimator, views):
    observations, T = observed(views)
    down = -views[0].T_camera_base[:3, 1]
    found = estimator(observations, omad.Known(gravity=down), T_world_camera=T)
    for estimate, T_world in zip(found, T, strict=True):
        assert np.allclose((T_world @ estimate.T_camera_base)[:3, 1], [0, 1, 0], atol=1e-5)


def test_a_rolled_first_camera_rolls_no_other(estimator):
    """Gravity levels each camera as that one is rolled."""
    views = moment(estimator, 1, 3)
    observations, T = observed(views)
    quarter = rigid(Rotation.from_rotvec([0, 0, np.pi / 2]).as_matrix(), np.zeros(3))
    clouds = [observation.points for observation in observations]
    clouds[0] = carry(quarter.T, clouds[0])
    T[0] = T[0] @ quarter
    down = -np.linalg.inv(T[0])[:3, 1]
    seen = [omad.Observation.from_points(points) for points in clouds]
    found = estimator(seen, omad.Known(gravity=down), T_world_camera=T)[0]
    assert abs(found.joint_states[0] - views[0].states[0]) < 0.05
    assert found.probability is not None
    assert found.probability > 0.9


def test_views_of_rolled_cameras_are_each_levelled_where_gravity_is_known(estimator):
    """Each alone, too, which is what they are held against."""
    views = moment(estimator, 2, 3)
    observations, T = observed(views)
    quarter = rigid(Rotation.from_rotvec([0, 0, np.pi / 2]).as_matrix(), np.zeros(3))
    rolled = [omad.Observation.from_points(carry(quarter.T, each.points)) for each in observations]
    level = estimator(observations, omad.Known(gravity=-np.linalg.inv(T[0])[:3, 1]), T_world_camera=T)
    found = estimator(rolled, omad.Known(gravity=-np.linalg.inv(T[0] @ quarter)[:3, 1]), T_world_camera=T @ quarter)
    for one, other in zip(found, level, strict=True):
        assert one.joint_states == pytest.approx(other.joint_states, abs=np.radians(1))
        alone = [[joint.state for joint in each.joints_alone] for each in (one, other)]
        assert alone[0] == pytest.approx(alone[1], abs=np.radians(2))
        assert len(one.warnings) == len(other.warnings)


def test_separate_targets_are_a_weighted_mean_without_robustness(estimator):
    """Least squares of two sets of targets are those of their mean by weight, with the weights' sum."""
    prior, generator = estimator.net.prior, torch.Generator().manual_seed(0)
    M, J, D = prior.num_keypoints, prior.tree.num_joints, prior.basis_size
    start = State(prior.beta_mean[None], torch.full((1, J), 0.3), torch.eye(4)[None])
    true = prior.deform(start.beta, start.joint_states + 0.2, start.T_camera_base).detach()
    seen = true + 0.02 * torch.randn(2, M, 3, generator=generator)
    weights = 1000 * torch.rand(2, M, generator=generator) + 100
    config, limits = RefinementConfig(huber=None), torch.tensor([[-2.0, 2.0]] * J)
    total = weights.sum(0)
    mean = (weights[..., None] * seen).sum(0) / total[:, None]
    merged = Refiner(prior, limits, config)(Targets(mean[None], total[None]), start)
    both = Targets(seen.transpose(0, 1).reshape(1, 2 * M, 3), weights.mT.reshape(1, 2 * M))
    apart = Refiner(prior.repeated(2), limits, config)(both, start)
    plain = Refiner(prior.repeated(2), limits, replace(config, backend="torch"))(both, start)
    for found in (apart, plain):
        assert torch.allclose(found.state.pack(), merged.state.pack(), atol=2e-5)
        assert torch.allclose(found.covariance, merged.covariance, rtol=1e-3, atol=1e-8)
    assert apart.covariance.shape == (1, 6 + J + D, 6 + J + D)


@pytest.mark.parametrize("shape", [(3, 4, 4), (4, 4), (2, 3, 4)])
def test_wrong_shapes_are_named(estimator, views, shape):
    observations, _ = observed(views[:2])
    with pytest.raises(omad.InputError, match=r"T_world_camera: expected .* shape \(2, 4, 4\)"):
        estimator(observations, T_world_camera=np.zeros(shape))


def test_what_is_no_pose_is_named(estimator, views):
    observations, T = observed(views[:2])
    for wrong in (2 * np.eye(4), np.diag([1.0, 1, -1, 1]), np.full((4, 4), np.nan)):
        with pytest.raises(omad.InputError, match="T_world_camera: that of view 2"):
            estimator(observations, T_world_camera=np.stack([T[0], wrong]))
    with pytest.raises(omad.InputError, match="list"):
        estimator(observations[0], T_world_camera=T[:1])
    with pytest.raises(omad.InputError, match=r"known: is dict; give an omad\.Known"):
        estimator(observations, {"gravity": [0, 1, 0]}, T)


def test_poses_that_single_precision_has_rounded_are_named(estimator, views):
    observations, T = observed(views[:2])
    far = T.copy()
    far[:, :3, 3] += (5e5, 4e6, 0.0)
    with pytest.raises(omad.InputError, match=r"T_world_camera: single precision .* to 0.25 m only; give doubles"):
        estimator(observations, T_world_camera=far.astype(np.float32))
    near, *_ = estimator(observations, T_world_camera=T)
    same, *_ = estimator(observations, T_world_camera=far)
    assert same.joints[0].state == pytest.approx(near.joints[0].state, abs=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "moments"), [("laptop", 20), ("eyeglasses", 40), ("dishwasher", 20), ("drawer", 20)])
def test_three_views_err_less_than_one_and_say_so(name, moments):
    estimator = Estimator.from_pretrained(name, device="cpu")
    off, turned, held = ([], []), ([], []), ([], [])
    for index in range(moments):
        views = moment(estimator, index, 3)
        observations, T = observed(views)
        for few, estimates in enumerate([estimator(observations), estimator(observations, T_world_camera=T)]):
            for estimate, view in zip(estimates, views, strict=True):
                error = np.abs(estimate.joint_states - view.states)
                R = Rotation.from_matrix(estimate.T_camera_base[:3, :3].T @ view.T_camera_base[:3, :3])
                off[few].append(error)
                turned[few].append(R.magnitude())
                held[few].append(error < 1.645 * np.array([joint.state_std for joint in estimate.joints]))
    assert np.mean(off[1]) < 0.95 * np.mean(off[0])
    assert np.mean(turned[1]) < 0.95 * np.mean(turned[0])
    assert np.mean(held[1]) > np.mean(held[0]) - 0.05
