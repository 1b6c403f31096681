"""Cameras and rigid motions: there and back again, and the same as torch's."""

import numpy as np
import pytest
import torch

from omad.geometry.camera import STANDARD_CAMERA, Camera
from omad.geometry.lens import Distortion
from omad.geometry.mesh import Mesh, convex_hull, merge_meshes
from omad.geometry.rigid import across, bounding_sphere, box, carry, carry_each, rigid, turned_about
from omad.geometry.transforms import so3_exp, transform_points

LENS = Distortion("plumb_bob", (0.1, -0.2, 0.001, -0.0005, 0.05))


def random_points(count: int = 50) -> np.ndarray:
    return np.random.default_rng(0).uniform([-0.3, -0.2, 0.8], [0.3, 0.2, 1.5], (count, 3))


def random_motion(seed: int = 0) -> np.ndarray:
    draw = torch.Generator().manual_seed(seed)
    return rigid(so3_exp(torch.randn(3, generator=draw, dtype=torch.float64)).numpy(), [0.1, -0.2, 0.3])


@pytest.mark.parametrize("lens", [None, LENS])
def test_what_is_projected_is_found_again(lens):
    camera, points = Camera.from_K(STANDARD_CAMERA.K, 640, 480, lens), random_points()
    assert np.allclose(camera.backproject(camera.project(points), points[:, 2]), points, atol=1e-8)


def test_an_intrinsic_matrix_may_be_a_list():
    assert Camera.from_K(STANDARD_CAMERA.K.tolist(), 640, 480) == STANDARD_CAMERA  # type: ignore[arg-type]


def test_a_zoomed_camera_sees_the_same_things_cut_and_scaled():
    points = random_points()
    zoomed = STANDARD_CAMERA.zoomed(2.5, 100.0, 50.0, (300, 200))
    assert (zoomed.width, zoomed.height) == (300, 200)
    assert np.allclose(zoomed.project(points), 2.5 * (STANDARD_CAMERA.project(points) - (100, 50)))


def test_points_are_carried_as_torch_carries_them():
    T, points = random_motion(), random_points()
    expected = transform_points(torch.as_tensor(T), torch.as_tensor(points)).numpy()
    assert np.allclose(carry(T, points), expected)
    assert np.allclose(carry_each(np.stack([T] * len(points)), points), expected)


def test_a_turn_about_a_point_leaves_it_there():
    R, point = random_motion()[:3, :3], np.array([0.4, 0.1, -0.2])
    assert np.allclose(carry(turned_about(R, point), point), point)


def test_directions_across_an_axis_are_right_handed_with_it():
    axis = random_motion()[:3, 0]
    assert np.allclose(np.linalg.det(np.stack([axis, *across(axis)])), 1)


def test_the_sphere_holds_all_points():
    centre, radius = bounding_sphere(random_points())
    assert np.linalg.norm(random_points() - centre, axis=1).max() == pytest.approx(radius)


def test_hulls_stay_closed_when_mirrored_and_merged():
    hull = convex_hull(random_points())
    both = merge_meshes([hull, hull.mirrored()])

    def volume(mesh: Mesh) -> float:
        return float(np.linalg.det(mesh.triangles).sum() / 6)

    assert volume(hull) > 0
    assert volume(both) == pytest.approx(2 * volume(hull))


@pytest.mark.parametrize("count", [1, 255, 256, 1000])
@pytest.mark.parametrize("width", [2, 3])
def test_box_is_smallest_and_largest_of_each_coordinate(count, width):
    points = np.random.default_rng(count).normal(size=(count, width)).astype(np.float32)
    for some in (points, points[::-1], np.asfortranarray(points)):
        assert np.array_equal(box(some), [points.min(0), points.max(0)])


def test_a_zoomed_camera_keeps_its_lens():
    camera = Camera(640, 480, 600, 610, 320, 238, Distortion("plumb_bob", (-0.3, 0.1, 0.001, 0.002)))
    points = np.random.default_rng(0).uniform((-0.4, -0.3, 0.9), (0.4, 0.3, 1.1), (50, 3))
    assert np.allclose(camera.zoomed(0.25, 20, 10).project(points), 0.25 * (camera.project(points) - (20, 10)))
