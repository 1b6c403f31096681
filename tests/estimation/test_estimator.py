"""The estimator on rendered views of unseen objects, with the shipped weights."""

import json
import pickle
from concurrent.futures import ThreadPoolExecutor
from multiprocessing.reduction import ForkingPickler
from pathlib import Path

import numpy as np
import pytest
import torch
import yourdfpy
from scipy.spatial.transform import Rotation

import omad
from helpers.categories import CATEGORIES
from helpers.golden import golden
from omad.data.procedural import generate
from omad.data.rendering.standard_views import View, standard_view, true_pose
from omad.estimation.estimator import Estimator, EstimatorConfig
from omad.estimation.joint_estimate import JointEstimate
from omad.estimation.known import Near
from omad.evaluation.baselines.adam import adam_refinement
from omad.geometry.joint_kinds import REVOLUTE, motion_of

NAMES = list(CATEGORIES)


@pytest.fixture(scope="module", params=NAMES)
def estimator(request) -> Estimator:
    return Estimator.from_pretrained(request.param, device="cpu")


def some_views(estimator: Estimator, count: int = 4) -> list[View]:
    category = estimator.category
    return [standard_view(generate(category, i, "test", 7), category, (7, i)) for i in range(count)]


def observe(view: View) -> omad.Observation:
    return omad.Observation.from_depth(view.depth, view.camera.K)


def test_weights_are_shipped():
    assert {"laptop", "dishwasher"} <= set(NAMES)


def test_five_lines(estimator):
    view = some_views(estimator, 1)[0]
    estimate = estimator(observe(view))
    truth = true_pose(view, estimator.category)
    assert np.degrees(abs(estimate.joints[0].state - view.states[0])) < 10
    assert estimate.converged
    assert estimate.T_camera_base.shape == (4, 4)
    assert estimate.keypoints.shape == (estimator.category.num_keypoints, 3)
    assert estimate.covariance.shape[0] == 6 + len(truth.states) + len(estimate.beta)
    assert np.linalg.eigvalsh(estimate.covariance).min() > -1e-9
    assert np.allclose(estimate.T_camera_base[:3, :3] @ estimate.T_camera_base[:3, :3].T, np.eye(3), atol=1e-5)


@pytest.mark.slow
def test_a_batch_gives_what_single_calls_give(estimator):
    observations = [observe(view) for view in some_views(estimator)]
    together = estimator(observations)
    differences = []
    for one, observation in zip(together, observations, strict=True):
        alone = estimator(observation)
        difference = np.linalg.norm(alone.keypoints - one.keypoints, axis=1)
        # a rounding error may put a point on the other side of a neighbourhood's border, which moves keypoints a little
        assert (difference < 0.1 * one.keypoint_std).all()
        assert np.allclose(alone.joint_states, one.joint_states, atol=2e-3)
        differences.append(difference)
    assert np.median(differences) < 1e-5


def test_answers_and_estimators_go_to_other_processes():
    estimator = Estimator.from_pretrained("laptop", device="cpu")
    observation = observe(some_views(estimator, 1)[0])
    estimate = estimator(observation).without_labels()
    sent = pickle.dumps(estimate)
    assert len(sent) < 30_000  # neither the bank of surfaces nor the network
    one, other = pickle.loads(sent), pickle.loads(pickle.dumps(estimate))
    assert one.to_dict() == estimate.to_dict()
    for part, mine in zip(one.parts, estimate.parts, strict=True):
        assert np.array_equal(part.mesh_in_camera.vertices, mine.mesh_in_camera.vertices)
        assert np.array_equal(part.mesh.faces, mine.mesh.faces)
    assert other.surfaces.bank is one.surfaces.bank  # of many answers not one each
    sent = pickle.dumps(estimator)
    assert len(sent) < 1.1 * sum(value.nbytes for value in estimator.net.state_dict().values())
    assert pickle.loads(sent)(observation).joint_states.tolist() == estimate.joint_states.tolist()
    ForkingPickler.dumps(estimator)  # as to a pool: moves the sender's tensors to shared memory
    taken = [np.full(estimator.net.backbone.config.pooled, np.nan, np.float32) for _ in range(10_000)]
    assert estimator(observation).joint_states.tolist() == estimate.joint_states.tolist()
    del taken


def test_the_same_input_gives_the_same_answer(estimator):
    observation = observe(some_views(estimator, 1)[0])
    assert np.allclose(estimator(observation).keypoints, estimator(observation).keypoints, atol=1e-6)


def test_cloud_and_depth_agree(estimator):
    view = some_views(estimator, 1)[0]
    observation = observe(view)
    shuffled = np.random.default_rng(0).permutation(observation.points)
    a, b = estimator(observation), estimator(omad.Observation.from_points(shuffled))
    assert np.degrees(abs(a.joints[0].state - b.joints[0].state)) < 3
    assert np.linalg.norm(a.keypoints - b.keypoints, axis=1).mean() < 0.05 * np.ptp(a.keypoints, axis=0).max()


@pytest.mark.slow
def test_part_labels_match_the_rendered_ones(estimator):
    shares = []
    for view in some_views(estimator):
        observation = observe(view)
        columns, rows = observation.pixels.T
        shares.append((estimator(observation).part_labels == view.labels[rows, columns]).mean())
    assert np.mean(shares) > 0.9


@pytest.mark.slow
def test_what_is_no_such_object_is_doubtful(estimator):
    rng = np.random.default_rng(0)
    ball = rng.normal(size=(3000, 3))
    ball = 0.05 * ball / np.linalg.norm(ball, axis=1, keepdims=True) + [0, 0, 1.0]
    assert any(warning.startswith("network: ") for warning in estimator(omad.Observation.from_points(ball)).warnings)
    good = [estimator(observe(view)) for view in some_views(estimator)]
    assert not any(warning.startswith("network: ") for estimate in good for warning in estimate.warnings)


@pytest.mark.parametrize(
    ("limits", "state", "fraction"),
    [((0.0, 1.5), 0.3, 0.2), ((-1.2, 0.0), -0.3, 0.25), ((-1.4, 1.5), -1.4, 0.0), ((-1.2, 0.0), 0.06, -0.05)],
)
def test_travel_begins_at_the_limit_nearer_to_rest(limits, state, fraction):
    axis = np.array([1.0, 0, 0])
    joint = omad.estimation.estimate.JointEstimate("joint", "revolute", state, 0.0, limits, axis, None, REVOLUTE)
    assert joint.fraction == pytest.approx(fraction)


def test_few_points_still_give_an_answer(estimator):
    observation = observe(some_views(estimator, 1)[0])
    sparse = omad.Observation.from_points(observation.points[:: len(observation.points) // 60])
    assert np.isfinite(estimator(sparse).keypoints).all()


def test_what_is_written_into_arrays_of_an_answer_is_not_in_the_answer(estimator):
    estimate = estimator(observe(some_views(estimator, 1)[0]))
    told, model = estimate.to_json(), estimate.object_model()
    for array in (estimate.T_camera_part, estimate.T_camera_base, estimate.joint_states, model.axes, model.pivots):
        array[...] = 9
    assert estimate.to_json() == told
    assert np.allclose(np.linalg.norm(estimate.object_model().axes, axis=1), 1)


def test_a_filtered_answer_is_as_unsure_as_the_filter(estimator):
    one = estimator(observe(some_views(estimator, 1)[0]))
    here = Near(one.T_camera_base, one.joint_states, one.beta, np.eye(len(one.beta)))
    wider = estimator.moved(one, here, 4 * one.covariance)
    np.testing.assert_allclose(wider.base_std, 2 * one.base_std)
    assert wider.joints[0].state_std == pytest.approx(2 * one.joints[0].state_std)


def test_json_has_what_is_promised(estimator):
    estimate = estimator(observe(some_views(estimator, 1)[0]))
    answer = json.loads(estimate.to_json())
    assert {"category", "converged", "residual", "beta", "T_camera_base", "joints", "parts", "keypoints"} <= set(answer)
    joint = answer["joints"][0]
    promised = "name type state state_std interval_50 interval_90 limits fraction axis pivot"
    assert set(joint) == set(promised.split())
    assert joint["state_std"] > 0
    assert {"name", "T_camera_part", "points"} == set(answer["parts"][0])
    assert sum(part["points"] for part in answer["parts"]) == np.count_nonzero(estimate.part_labels >= 0)
    assert {"joints", "T_camera_base"} <= set(answer["initial"])


def test_a_urdf_in_a_folder_has_its_state_beside_it(estimator, tmp_path, monkeypatch):
    estimate = estimator(observe(some_views(estimator, 1)[0]))
    monkeypatch.chdir(tmp_path)
    for folder in (Path("mine"), Path("of/two"), Path()):
        estimate.save_urdf(folder)
        assert {"model.urdf", "state.json"} <= {file.name for file in folder.iterdir()}
    assert not Path("of/state.json").exists()


def test_urdf_of_an_estimate_moves_as_the_estimate_says(estimator, tmp_path):
    estimate = estimator(observe(some_views(estimator, 1)[0]))
    estimate.save_urdf(tmp_path / "object.urdf")
    state = json.loads((tmp_path / "state.json").read_text())
    robot = yourdfpy.URDF.load(str(tmp_path / "object.urdf"))
    robot.update_cfg(state["joint_states"])
    placed = zip(estimate.surface.parts, estimate.T_camera_part, strict=True)
    expected = np.concatenate([part.carried(T).vertices for part, T in placed])
    for node in robot.scene.graph.nodes_geometry:
        T_base_mesh, geometry = robot.scene.graph[node]
        T = np.array(state["T_camera_base"]) @ T_base_mesh
        corners = np.asarray(robot.scene.geometry[geometry].vertices) @ T[:3, :3].T + T[:3, 3]
        gap = np.linalg.norm(corners[:, None] - expected[None], axis=-1).min(1)
        assert gap.max() < 1e-5


def test_waypoints_follow_the_joint(estimator):
    estimate = estimator(observe(some_views(estimator, 1)[0]))
    part = estimator.category.parts[1].name
    model = estimate.object_model()
    target = model.limits[0, 1]
    point = estimate.keypoints[np.array(estimator.category.part_of_keypoint) == 1][0]
    path = estimate.waypoints(part, point, target, steps=7)
    assert np.allclose(path[0], point)
    canonical = np.linalg.inv(estimate.T_camera_part[1]) @ np.append(point, 1)
    moved = model.part_transforms(np.full(len(model.axes), target), estimate.T_camera_base)[1] @ canonical
    assert np.allclose(path[-1], moved[:3], atol=1e-5)
    with pytest.raises(omad.InputError, match="does not move"):
        estimate.waypoints(estimator.category.parts[0].name, point, target)


@pytest.mark.parametrize("degrees", [90, 180, -60])
def test_gravity_tells_how_a_camera_is_rolled(estimator, degrees):
    roll = Rotation.from_euler("z", degrees, degrees=True).as_matrix()
    for view in some_views(estimator, 2):
        observation, down = observe(view), -view.T_camera_base[:3, 1]
        level = estimator(observation, omad.Known(gravity=down))
        rolled = estimator(omad.Observation.from_points(observation.points @ roll.T), omad.Known(gravity=roll @ down))
        assert np.allclose(rolled.joint_states, level.joint_states, atol=0.05)
        assert np.allclose(rolled.T_camera_base[:3, :3], roll @ level.T_camera_base[:3, :3], atol=0.05)


def test_a_moved_answer_says_how_far_it_is_from_what_was_seen():
    estimator = Estimator.from_pretrained("laptop", device="cpu")
    estimate = estimator(observe(some_views(estimator, 1)[0]))
    covariance = np.eye(len(estimate.beta))
    ajar = Near(estimate.T_camera_base, estimate.joint_states + 0.3, estimate.beta, covariance)
    moved = estimator.moved(estimate, ajar, estimate.covariance)
    apart = np.linalg.norm(moved.keypoints - moved.observed_keypoints, axis=1)
    assert moved.residual == pytest.approx(np.sqrt(np.square(apart).mean()))
    assert moved.residual > 2 * estimate.residual


def test_what_is_known_is_kept_and_helps(estimator):
    view = some_views(estimator, 1)[0]
    observation, truth = observe(view), true_pose(view, estimator.category)
    down = -view.T_camera_base[:3, 1]
    plain = estimator(observation)
    known = omad.Known(beta=plain.beta, joint_states=view.states, gravity=down)
    held = estimator(observation, known)
    assert np.allclose(held.beta, plain.beta, atol=1e-6)
    assert np.allclose(held.joint_states, view.states, atol=1e-6)
    assert np.allclose(-held.T_camera_base[:3, 1], down, atol=1e-5)
    assert held.joints[0].state_std == 0
    assert np.linalg.norm(held.T_camera_part[0] - truth.T_camera_part[0]) < 0.5
    with pytest.raises(omad.InputError, match="known gravity"):
        estimator(observation, omad.Known(gravity=np.zeros(3)))
    with pytest.raises(omad.InputError, match="known beta"):
        estimator(observation, omad.Known(beta=np.zeros(3)))


@pytest.mark.slow
@pytest.mark.parametrize("estimator", ["laptop", "drawer"], indirect=True)
def test_adam_recipe_is_an_option_and_agrees(estimator):
    observation = observe(some_views(estimator, 1)[0])
    adam = Estimator(estimator.net, refine=adam_refinement)(observation)
    ours = estimator(observation)
    assert np.degrees(abs(adam.joints[0].state - ours.joints[0].state)) < 5
    assert adam.seconds["refinement"] > 10 * ours.seconds["refinement"]


@pytest.mark.slow
@pytest.mark.parametrize("estimator", ["laptop", "drawer"], indirect=True)
def test_show_draws_a_picture(estimator, tmp_path):
    observation = observe(some_views(estimator, 1)[0])
    omad.show(observation, estimator(observation), tmp_path / "picture.png")
    from PIL import Image

    pixels = np.asarray(Image.open(tmp_path / "picture.png").convert("L"))
    assert pixels.shape[0] > 500
    assert pixels.std() > 10


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs CUDA")
def test_cpu_and_cuda_agree(estimator):
    observations = [observe(view) for view in some_views(estimator)]
    there = Estimator.from_pretrained(estimator.category.name, device="cuda")(observations)
    for a, b in zip(estimator(observations), there, strict=True):
        assert np.allclose(a.keypoints, b.keypoints, atol=2e-3)


def test_without_labels_the_points_are_forgotten(estimator):
    estimate = estimator(observe(some_views(estimator, 1)[0]))
    small = estimate.without_labels()
    assert len(small.part_labels) == 0
    assert [part["points"] for part in small.to_dict()["parts"]] == [None] * len(estimator.category.parts)
    assert np.array_equal(small.keypoints, estimate.keypoints)


def test_two_threads_get_the_answers_of_one(estimator):
    """The network's buffers, the fit and its constants are shared, or each thread's own."""
    observations = golden(estimator.category.name)[0][:12]
    expected = [estimator(one) for one in observations]
    # a matrix product's rounding depends on how many threads share it, and each thread has its own number
    with ThreadPoolExecutor(2, initializer=torch.set_num_threads, initargs=(torch.get_num_threads(),)) as pool:
        found = list(pool.map(estimator, 3 * observations))
    for one, other in zip(found, 3 * expected, strict=True):
        assert np.array_equal(one.keypoints, other.keypoints)
        assert np.array_equal(one.covariance, other.covariance, equal_nan=True)
        assert np.array_equal(one.part_labels, other.part_labels)


def test_looking_less_still_finds_the_object(estimator):
    clouds, data = golden(estimator.category.name)
    observations, states = clouds[:24], data["states"][:24]
    fast = Estimator(estimator.net, EstimatorConfig.fast())
    off = [np.abs([e.joint_states for e in each(observations)] - states) for each in (estimator, fast)]
    assert np.median(off[1]) < 2 * np.median(off[0])


def test_each_way_of_answering_is_compiled_ahead(monkeypatch):
    """Laptops' answers ask for surfaces, microwaves' for either hand: what one needs does not do for the other."""
    found = []
    monkeypatch.setattr("omad.estimation.estimator.compile_ahead", lambda answers, category, ways: found.append(ways))
    for name in ("laptop", "microwave", "laptop"):
        omad.Estimator.from_pretrained(name, "cpu")
    first, other, again = found
    assert first == again != other
    assert len({*found}) == 2


@pytest.mark.parametrize("pitch", [0.03, -0.03])
def test_the_pitch_of_a_screw_is_what_a_whole_turn_advances(pitch):
    axis, pivot = np.array([0.6, 0.0, 0.8]), np.array([0.1, 0.2, 0.9])
    lid = JointEstimate("lid", "screw", 1.0, 0.01, (0.0, 9.0), axis, pivot, motion_of("screw", pitch))
    turned = lid.motion(2 * np.pi)
    assert np.allclose(turned[:3, :3], np.eye(3))
    assert turned[:3, 3] == pytest.approx(pitch * axis)
    assert lid.to_dict()["pitch"] == pytest.approx(pitch)
