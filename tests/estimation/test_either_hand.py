"""Objects of the other hand: taken as mirror images, estimated in the mirror, and given back as they are."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from scipy.special import expit

import omad
from helpers.categories import DISHWASHER, EVERY
from helpers.own_models import microwave
from omad.common.errors import InputError
from omad.data.procedural import generate
from omad.data.rendering.standard_views import standard_view, true_pose
from omad.data.source import load_models
from omad.data.urdf_import.folder import import_with_notes
from omad.estimation.estimator import Estimator
from omad.estimation.joint_estimate import JointEstimate
from omad.estimation.known import Known, Near
from omad.estimation.looks.beginning import ANYWHERE, Beginning
from omad.estimation.looks.either_hand import surer_hands, told
from omad.evaluation.metrics import pose_errors
from omad.geometry.joint_kinds import PRISMATIC, REVOLUTE
from omad.geometry.rigid import mirrored, turned_about
from omad.geometry.transforms import MIRROR_X
from omad.objects.category import Category
from omad.objects.urdf import write_urdf

HANDED = sorted(name for name, category in EVERY.items() if category.either_hand)


@pytest.fixture(scope="module")
def estimator() -> Estimator:
    """A dishwasher is its own mirror image, nearly: what is right of one hand is right of the other."""
    estimator = omad.Estimator.from_pretrained("dishwasher", "cpu")
    estimator.net.category = replace(estimator.category, either_hand=True)
    return estimator


@pytest.fixture(scope="module")
def views() -> list:
    return [standard_view(generate(DISHWASHER, i, "test"), DISHWASHER, (4, i)) for i in range(4)]


@pytest.mark.parametrize("name", ["microwave", "drawer", "eyeglasses", "jar", "desk_lamp"])
def test_a_mirrored_model_moves_like_the_image_of_the_model(name):
    model = generate(EVERY[name], 3, "test")
    for states in np.random.default_rng(0).uniform(*model.limits.T, (3, len(model.limits))):
        for seen, image in zip(model.posed_vertices(states), model.mirrored().posed_vertices(states), strict=True):
            np.testing.assert_allclose(seen * MIRROR_X, image, atol=1e-12)
    assert model.mirrored().closed == model.closed


@pytest.mark.parametrize("name", HANDED)
def test_models_of_the_other_hand_are_imported_as_their_mirror_image(name, tmp_path):
    category = EVERY[name]
    for index in range(3):
        model = generate(category, index, "test")
        for thing, notes in ((model, 0), (model.mirrored(), 1)):
            file = write_urdf(thing, tmp_path / str(index) / str(notes) / "thing.urdf")
            imported = import_with_notes(file, category)
            found = imported.model
            assert len(imported.notes) == notes
            np.testing.assert_allclose(found.part_boxes(), model.part_boxes(), atol=1e-6)
            np.testing.assert_allclose(found.axes, model.axes, atol=1e-6)
            np.testing.assert_allclose(found.limits, model.limits, atol=1e-6)


def test_a_category_of_one_hand_has_no_mirrored_objects(tmp_path):
    with pytest.raises(InputError, match="one hand"):
        load_models("mirrored", DISHWASHER, 1, "test", 0)
    [mirrored] = load_models("mirrored", EVERY["microwave"], 1, "test", 0).models
    assert mirrored.axes[0, 1] > 0.9  # hinged at the right
    assert microwave().mirrored().pivots[0, 0] == -microwave().pivots[0, 0]


def test_a_thread_cannot_be_of_either_hand():
    jar = EVERY["jar"]
    with pytest.raises(ValueError, match="either_hand"):
        Category(**vars(jar) | {"either_hand": True})


def test_an_observation_in_the_mirror_is_seen_by_a_camera(views):
    seen = views[0].observation()
    image = seen.mirrored()
    again = omad.Observation.from_depth(image.depth, image.camera, image.mask)
    again, expected = (points[np.lexsort(points.round(4).T)] for points in (again.points, image.points))
    np.testing.assert_allclose(again, expected, atol=1e-3)
    np.testing.assert_array_equal(image.mirrored().points, seen.points)


def test_an_answer_in_the_mirror_is_consistent_and_mirrored_back_the_same(estimator, views):
    estimate = estimator(views[0].observation())
    image = estimate.in_mirror()
    assert image.of_other_hand != estimate.of_other_hand
    assert np.linalg.det(image.T_camera_base[:3, :3]) == pytest.approx(1)
    T = image.T_camera_part[list(image.category.part_of_keypoint)]
    placed = (T[:, :3, :3] @ image.canonical_keypoints[..., None])[..., 0] + T[:, :3, 3]
    np.testing.assert_allclose(placed, image.keypoints, atol=1e-9)
    np.testing.assert_allclose(image.keypoints, estimate.keypoints * MIRROR_X, atol=1e-12)
    for joint, other in zip(estimate.joints, image.joints, strict=True):
        moved, there = (one.motion(0.3) @ [*at, 1] for one, at in ((joint, [0.1, 0.2, 0.3]), (other, [-0.1, 0.2, 0.3])))
        np.testing.assert_allclose(moved[:3] * MIRROR_X, there[:3], atol=1e-12)
    for mesh, other in zip(estimate.object_model().parts, image.object_model().parts, strict=True):
        np.testing.assert_allclose(mesh.vertices * MIRROR_X, other.vertices, atol=1e-6)
    again, flip = image.in_mirror(), np.diag(MIRROR_X)
    turns, shifts = slice(3), slice(3, 6)  # in a mirror a rotation vector's image is its negative
    for rows, columns, sign in ((turns, turns, 1), (shifts, shifts, 1), (turns, shifts, -1)):
        expected = sign * flip @ estimate.covariance[rows, columns] @ flip
        np.testing.assert_allclose(image.covariance[rows, columns], expected)
    np.testing.assert_allclose(image.covariance[6:, 3:6], estimate.covariance[6:, 3:6] @ flip)
    np.testing.assert_allclose(again.covariance, estimate.covariance)
    np.testing.assert_allclose(again.T_camera_part, estimate.T_camera_part)


def test_either_hand_answers_are_right(estimator, views):
    for view in views:
        [plain], [image] = (
            estimator._of_one_hand([observation], Known(), ANYWHERE)
            for observation in (view.observation(), view.observation().mirrored())
        )
        truth, boxes = true_pose(view, DISHWASHER), view.truth.part_boxes
        for answer in (plain, image.in_mirror()):
            errors = pose_errors(answer.pose(), truth, boxes, DISHWASHER)
            assert np.degrees(errors.joint_state).max() < 10
            assert np.degrees(errors.axis).max() < 10


def test_what_is_seen_in_a_mirror_gets_the_mirrored_answer(estimator, views):
    """The same two looks are had either way."""
    for view in views:
        one, other = estimator(view.observation()), estimator(view.observation().mirrored())
        assert one.of_other_hand != other.of_other_hand
        np.testing.assert_allclose(one.in_mirror().T_camera_part, other.T_camera_part, atol=1e-9)
        np.testing.assert_allclose(one.joint_states, other.joint_states, atol=1e-9)
        assert other.to_dict()["mirrored"] == other.of_other_hand
        assert set(one.seconds) == {"network", "refinement"}


def same(one: omad.Estimate, other: omad.Estimate) -> None:
    """Each is the other's image."""
    assert one.of_other_hand != other.of_other_hand
    np.testing.assert_allclose(one.in_mirror().T_camera_part, other.T_camera_part, atol=1e-6)
    np.testing.assert_allclose(one.joint_states, other.joint_states, atol=1e-6)


def test_what_is_known_goes_into_the_mirror_with_what_is_seen(estimator, views):
    view = views[0]
    seen, image, down = view.observation(), view.observation().mirrored(), -view.T_camera_base[:3, 1]
    one = estimator(seen)
    same(estimator(seen, Known(gravity=down)), estimator(image, Known(gravity=down * MIRROR_X)))
    near = Near(view.T_camera_base, one.joint_states, one.beta, np.eye(len(one.beta)))
    there = replace(near, T_camera_base=mirrored(near.T_camera_base))
    same(estimator.near(seen, near), estimator.near(image, there))
    frames = turned_about(Rotation.from_rotvec([0.3, -0.5, 0.2]).as_matrix(), np.array([0.1, 0.4, 2.0]))[None]
    np.testing.assert_allclose(Beginning(frames=frames).mirrored().frames, mirrored(frames))


def test_a_filtered_answer_keeps_its_hand(estimator, views):
    for observation in (views[0].observation(), views[0].observation().mirrored()):
        one = estimator(observation)
        here = Near(one.T_camera_base, one.joint_states, one.beta, np.eye(len(one.beta)))
        moved = estimator.moved(one, here, one.covariance)
        assert moved.of_other_hand == one.of_other_hand
        np.testing.assert_allclose(moved.keypoints, one.keypoints, atol=1e-4)


def test_a_hand_that_is_known_is_taken(estimator, views):
    seen = views[0].observation()
    assert [estimator(seen, Known(mirrored_probability=p)).of_other_hand for p in (0.0, 1.0)] == [False, True]
    tensor = torch.tensor(1.0, requires_grad=True)
    assert estimator(seen, Known(mirrored_probability=tensor)).of_other_hand  # type: ignore[arg-type]
    for wrong in (2.0, np.nan, torch.tensor(2.0), "1"):
        with pytest.raises(InputError, match=r"mirrored_probability: .* is no probability; give 0 to 1"):
            estimator(seen, Known(mirrored_probability=wrong))


def test_several_views_agree_on_a_hand(estimator):
    model = generate(DISHWASHER, 5, "test")
    views = [standard_view(model, DISHWASHER, (6, i), states=np.array([0.7])) for i in range(3)]
    poses = [np.linalg.inv(view.T_camera_base) for view in views]
    answers = estimator([view.observation() for view in views], T_world_camera=poses)
    assert len({answer.of_other_hand for answer in answers}) == 1
    for T, answer in zip(poses, answers, strict=True):
        np.testing.assert_allclose(T @ answer.T_camera_base, poses[0] @ answers[0].T_camera_base, atol=1e-6)
    images = [view.observation().mirrored() for view in views]
    for one, other in zip(answers, estimator(images, T_world_camera=mirrored(np.stack(poses))), strict=True):
        same(one, other)


def test_the_likelier_hand_is_taken_and_without_one_the_surer(views):
    estimator = omad.Estimator.from_pretrained("dishwasher", "cpu")
    plain, images = estimator.of_each_hand([view.observation() for view in views], Known())
    hand = np.random.default_rng(0).normal(size=len(told(plain[0])) + 1)
    for together in (False, True):
        pairs = zip(plain, images, strict=True)
        odds = np.array([[[*told(estimate), 1] for estimate in pair] for pair in pairs]) @ hand
        odds = np.mean(odds, 0, keepdims=True).repeat(len(views), 0) if together else odds
        found = surer_hands(plain, images, hand.tolist(), together)
        assert [e.of_other_hand for e in found] == [bool(row[1] > row[0]) for row in odds]
        assert [e.hand_probability for e in found] == pytest.approx(expit(np.abs(np.diff(odds)[:, 0]) / 2))
        for known in (0.0, 1.0):  # surely, whatever a view tells
            found = surer_hands(plain, images, hand.tolist(), together, known)
            assert [(e.of_other_hand, e.mirrored_probability) for e in found] == [(known == 1.0, known)] * len(views)
        weakly = surer_hands(plain, images, hand.tolist(), together, 0.5)
        assert [e.hand_probability for e in weakly] == pytest.approx(expit(np.abs(np.diff(odds)[:, 0]) / 2))
    surer = [np.log(a.keypoint_std).mean() > np.log(b.keypoint_std).mean() for a, b in zip(plain, images, strict=True)]
    for unknown in (None, 0.5):
        assert [e.of_other_hand for e in surer_hands(plain, images, (), False, unknown)] == surer
    assert all(e.of_other_hand for e in surer_hands(plain, images, (), False, 0.9))
    before = [*hand[:-3], hand[-1]]  # one that was fitted before the front was asked
    own, other = ([np.append(told(estimate)[:-2], 1) @ before for estimate in some] for some in (plain, images))
    assert [e.of_other_hand for e in surer_hands(plain, images, before, False)] == list(np.less(own, other))
    with pytest.raises(InputError, match=r"hand: of another network"):
        surer_hands(plain, images, (1.0, 2.0), False)


def test_where_the_hand_is_hardly_seen_it_is_told():
    estimator = omad.Estimator.from_pretrained("cabinet_one_door", "cpu")
    category = estimator.category
    models = [generate(category, i, "test") for i in range(16)]
    doubted = {}
    for state in (0.0, 70.0):
        views = [standard_view(model, category, (8, i), states=np.radians([state])) for i, model in enumerate(models)]
        answers = estimator([view.observation() for view in views])
        doubted[state] = sum(any(text.startswith("hand: ") for text in answer.warnings) for answer in answers)
        for answer in answers:
            assert 0.5 <= answer.hand_probability == answer.to_dict()["hand_probability"] <= 1
            assert any(text.startswith("hand: ") for text in answer.warnings) == (answer.hand_probability < 0.75)
            assert answer.in_mirror().hand_probability == answer.hand_probability
        surely = [answer for answer in answers if answer.hand_probability >= 0.75]
        assert sum(answer.of_other_hand for answer in surely) <= 1
    assert doubted[0.0] >= 4
    assert doubted[70.0] <= 2


@pytest.mark.parametrize("motion", [REVOLUTE, PRISMATIC])
def test_the_image_of_a_joint_moves_points_as_its_image(motion):
    axis, pivot = np.array([0.48, 0.6, 0.64]), np.array([0.1, 0.2, 0.9])
    joint = JointEstimate(
        "joint", "revolute" if motion.turns else "prismatic", 0.3, 0.01, (0.0, 1.0), axis, pivot, motion
    )
    joint = joint if motion.turns else replace(joint, pivot=None)
    flip = np.diag([-1.0, 1.0, 1.0, 1.0])
    assert np.allclose(joint.mirrored().motion(0.4), flip @ joint.motion(0.4) @ flip)
    assert joint.mirrored().state == joint.state
