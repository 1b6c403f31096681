"""Arguments that are none are refused with what is wrong; forks of a process that has estimated estimate, too."""

import multiprocessing
import os
from collections import deque
from contextlib import contextmanager
from copy import copy
from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest
import torch

from helpers.command_line import laptop_view
from omad.common.errors import InputError, NothingSeen
from omad.estimation.estimator import Estimator, EstimatorConfig
from omad.estimation.known import Known, Near
from omad.estimation.world import gravity_in_camera, in_world
from omad.output.formats import save_formats
from omad.sensing.observation import Observation


@cache
def estimator() -> Estimator:
    return Estimator.from_pretrained("laptop", "cpu")


def with_point(value: float) -> Observation:
    observation = laptop_view().observation()
    points = observation.points.copy()
    points[3, 1] = value
    return replace(observation, points=points)


NEAR = Near(np.eye(4), np.zeros(1), np.zeros(10), np.eye(10))


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e30])
def test_one_bad_observation_of_several_is_named(value):
    good = laptop_view().observation()
    with pytest.raises(InputError, match="observation 1: "):
        estimator()([good, with_point(value), good])


def test_what_lies_behind_the_camera_was_not_seen_by_it():
    cloud = laptop_view().observation().points
    with pytest.raises(InputError, match="observation 1: most of its points lie behind the camera"):
        estimator()([Observation(points=cloud), Observation(points=cloud * np.float32([1, -1, -1]))])


def test_what_is_no_config_is_named():
    for config in ({"samples": (1,)}, "fast", EstimatorConfig):
        with pytest.raises(InputError, match=r"config: is \w+; give an EstimatorConfig"):
            Estimator.from_pretrained("laptop", "cpu", config)  # type: ignore[arg-type]


def test_too_few_points_are_refused_however_they_come():
    cloud = laptop_view().observation().points
    with pytest.raises(NothingSeen, match="observation 1: 49 points, at least 50 are needed"):
        estimator()([Observation(points=cloud), Observation(points=cloud[:49])])
    assert len(estimator()([Observation(points=cloud[:50])])) == 1
    with pytest.raises(InputError, match=r"got \(3, \d+\); give its columns as rows: points\.T"):
        Observation.from_points(cloud.T)


@pytest.mark.parametrize("value", [None, 3, [None], ["x"], [laptop_view], Observation(np.ones((60, 3), dtype=object))])
def test_what_is_no_observation_is_named(value):
    with pytest.raises(InputError, match="observation"):
        estimator()(value)


@pytest.mark.parametrize(
    "known",
    [Known(beta="x"), Known(beta=np.full(10, np.nan)), Known(beta=np.full(10, 1e30)), Known(joint_states=["x"]),
     Known(joint_states=[np.inf]), Known(gravity=[0, 0, np.nan]), Known(gravity=[0, 0, 1e300]),
     Known(mirrored_probability=0.5), Known(joint_states=[90.0])],
)  # fmt: skip
def test_what_cannot_be_known_is_refused(known):
    view = laptop_view().observation()
    with pytest.raises(InputError, match="known "):
        estimator()(view, known)
    with pytest.raises(InputError, match="known "):
        estimator().near(view, NEAR, known)


def test_views_may_come_in_any_sequence_and_are_kept_in_sets():
    view = laptop_view().observation()
    views = deque([view, view.part(np.arange(len(view.points)) % 2 == 0)], maxlen=2)
    first, second = estimator()(views)
    assert first != second
    assert views.index(views[1]) == 1
    assert len({*views, first, second, first.joints[0], Known(beta=first.beta)}) == 6
    assert len(estimator()(views, T_world_camera=[np.eye(4)] * 2)) == 2


WRONG = [np.ones((4, 4)), np.eye(4)[:3], np.full((4, 4), np.nan), np.diag([1.0, 1.0, -1.0, 1.0]), "x"]


@pytest.mark.parametrize("pose", WRONG)
def test_what_is_no_pose_of_a_camera_is_refused_before_anything_is_written(pose, tmp_path):
    view = laptop_view().observation()
    estimate = estimator()(view)
    point = estimate.keypoints[-1]
    for ask in (
        lambda: in_world(estimate, pose),
        lambda: gravity_in_camera(pose),
        lambda: save_formats(estimate, view, tmp_path, ["ply", "urdf"], pose),
        lambda: estimate.waypoints("screen", point, 0.0, T_world_camera=pose),
    ):
        with pytest.raises(InputError, match="T_world_camera: "):
            ask()
    with pytest.raises(InputError, match="T_camera_handle: "):
        estimate.waypoint_poses("screen", pose, 0.0)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("form", [np.ndarray.tolist, torch.tensor])
def test_poses_of_cameras_may_be_lists_and_tensors(form):
    estimate, pose = estimator()(laptop_view().observation()), np.diag([-1.0, -1.0, 1.0, 1.0])
    assert in_world(estimate, form(pose)) == in_world(estimate, pose)
    assert np.array_equal(gravity_in_camera(form(pose)), gravity_in_camera(pose))


def test_numbers_of_a_configuration_may_be_of_any_kind_and_in_a_list():
    view = laptop_view().observation()
    listed = Estimator.from_pretrained("laptop", "cpu", EstimatorConfig(samples=[1, 3], batch=np.int64(3)))
    assert np.array_equal(listed(view).keypoints, estimator()(view).keypoints)


@pytest.mark.parametrize("seed", [np.int32(3), np.int64(3), np.uint64(3)])
def test_a_seed_may_be_of_numpys_kinds(seed):
    view, net = laptop_view().observation(), estimator().net
    given, expected = Estimator(net, EstimatorConfig(seed=seed)), Estimator(net, EstimatorConfig(seed=3))
    assert np.array_equal(given(view).keypoints, expected(view).keypoints)


def test_joint_states_none_of_which_is_known_are_nothing_known():
    """Of weights whose answers lean towards the network's own joint states, which those with something known do not."""
    net = copy(estimator().net)
    net.own_states = 0.5
    leaning, view = Estimator(net), laptop_view().observation()
    found = leaning(view, Known(joint_states=[np.nan]))
    assert found.joint_states[0] != estimator()(view).joint_states[0]
    assert np.array_equal(found.joint_states, leaning(view).joint_states)


@pytest.mark.parametrize("form", [lambda array: array[::-1].copy()[::-1], lambda array: array.astype(np.longdouble)])
def test_what_is_known_may_be_an_array_of_any_layout_and_precision(form):
    view = laptop_view().observation()
    plain = Known(beta=np.zeros(10), joint_states=np.array([0.3]), gravity=np.array([0.1, 1.0, 0.2]))
    given = Known(beta=form(plain.beta), joint_states=form(plain.joint_states), gravity=form(plain.gravity))
    found, expected = estimator()(view, given), estimator()(view, plain)
    assert np.array_equal(found.T_camera_base, expected.T_camera_base)


@pytest.mark.parametrize("settings", [{"samples": ()}, {"samples": (0,)}, {"batch": 0}, {"near_samples": 10**9},
                                      {"seed": -1}, {"seed": 2**64}])  # fmt: skip
def test_settings_that_cannot_be_are_refused(settings):
    with pytest.raises(InputError, match="EstimatorConfig"):
        EstimatorConfig(**settings)


@pytest.mark.parametrize("outlier", [1e38, 1e6])
def test_a_stray_point_beyond_all_measure_is_no_measurement(outlier):
    points = laptop_view().observation().points.astype(np.float64)
    found = Observation.from_points(np.concatenate([points, [[0, 0, outlier]]]))
    assert len(found.points) == len(points)


def test_an_image_of_one_row():
    depth = np.ones((1, 400), np.float32)
    assert len(Observation.from_depth(depth, (300, 300, 200, 0)).points) == 400


def test_an_image_of_twelve_megapixels_is_thinned():
    """To what a network can use; along both sides alike, and with the pixels that it is made of."""
    depth = np.zeros((3000, 4000), np.float32)
    depth[200:2900, 100:3900] = 1.5
    K = (3800, 3800, 1999.5, 1499.5)
    found = Observation.from_depth(depth, K)
    assert 500_000 < len(found.points) <= 1_500_000
    assert found.pixels is not None
    assert found.mask is not None
    assert found.mask.sum() == (depth > 0).sum()
    column, row = found.pixels[1234]
    ray = np.array([(column - 1999.5) / 3800, (row - 1499.5) / 3800, 1])
    np.testing.assert_allclose(found.points[1234], 1.5 * ray, rtol=1e-5)
    table = Observation.from_depth(depth, K, box=(1000, 1000, 1100, 1100))
    assert len(table.points) == 10_000


@contextmanager
def double_precision():
    torch.set_default_dtype(torch.float64)
    try:
        yield
    finally:
        torch.set_default_dtype(torch.float32)


SETTINGS = [
    double_precision,
    torch.inference_mode,
    partial(torch.autocast, "cpu", torch.bfloat16),
    partial(torch.device, "meta"),
]


@pytest.mark.parametrize("setting", SETTINGS)
def test_what_a_program_has_set_of_pytorch_changes_no_answer(setting):
    view = laptop_view().observation()
    expected = estimator()(view)
    with setting():
        own = Estimator.from_pretrained("laptop", "cpu")
        inside = own(view)
        surface = inside.to_surface()
        together = own([view, view], T_world_camera=[np.eye(4)] * 2)
        moved = own.moved(inside, NEAR, np.eye(17))
    assert np.array_equal(inside.keypoints, expected.keypoints)
    assert np.array_equal(own(view).keypoints, expected.keypoints)
    assert np.array_equal(surface.keypoints, expected.to_surface().keypoints)
    assert np.array_equal(moved.keypoints, own.moved(expected, NEAR, np.eye(17)).keypoints)
    assert np.isfinite(together[1].keypoints).all()


def _answer(pipe) -> None:
    pipe.send(estimator()(laptop_view().observation()).joint_states)


@pytest.mark.skipif("fork" not in multiprocessing.get_all_start_methods(), reason="needs fork")
def test_a_fork_estimates_where_its_parent_used_threads():
    threads = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        expected = estimator()(laptop_view().observation()).joint_states
        torch.ones(2_000_000).exp()  # so that there are threads
        ours, theirs = multiprocessing.Pipe()
        child = multiprocessing.get_context("fork").Process(target=_answer, args=(theirs,))
        child.start()
        try:
            assert ours.poll(120), "the fork hangs"
            np.testing.assert_allclose(ours.recv(), expected, atol=1e-5)
        finally:
            os.kill(child.pid or 0, 9)
            child.join()
    finally:
        torch.set_num_threads(threads)
