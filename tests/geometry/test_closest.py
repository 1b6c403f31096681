"""Distances to surfaces against every triangle in turn, volumes against closed forms."""

import numpy as np
import pytest
import trimesh
from trimesh.triangles import closest_point

from omad.geometry.closest import Surface, nearest_of
from omad.geometry.mesh import Mesh, closed, merge_meshes, sample_triangles
from omad.geometry.occupancy import occupancy


def solid(made: trimesh.Trimesh) -> Mesh:
    return Mesh(np.asarray(made.vertices, np.float64), np.asarray(made.faces, np.int64))


def true_distances(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    nearest = [closest_point(np.repeat(each[None], len(points), 0), points) for each in triangles]
    return np.linalg.norm(np.stack(nearest) - points, axis=-1).min(0)


def test_nearest_point_of_all_triangles():
    rng = np.random.default_rng(0)
    triangles, points = rng.normal(size=(30, 3, 3)), 2 * rng.normal(size=(200, 3))
    every = np.tile(np.arange(30), (200, 1))
    found, which = nearest_of(points, triangles, every)
    assert np.allclose(np.linalg.norm(found - points, axis=1), true_distances(points, triangles), atol=1e-12)
    on_their_own = closest_point(triangles[which], points)
    assert np.allclose(found, on_their_own, atol=1e-12)


def test_triangles_without_area_are_lines_and_points():
    triangles = np.array([[[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[5, 5, 5]] * 3], float)
    points = np.array([[0.5, 1.0, 0.0], [5.0, 5.0, 7.0]])
    found, which = nearest_of(points, triangles, np.array([[0, 1], [0, 1]]))
    assert which.tolist() == [0, 1]
    assert np.allclose(np.linalg.norm(found - points, axis=1), [1.0, 2.0])
    for corners in ([0, 0, 2], [0, 2, 0], [2, 0, 0]):
        found, _ = nearest_of(points[:1], triangles[:1, corners], np.array([[0]]))
        assert found.tolist() == [[0.5, 0.0, 0.0]]


def test_surface_finds_the_nearest_triangles_by_samples():
    mesh = merge_meshes([solid(trimesh.creation.icosphere(2)), solid(trimesh.creation.box([0.5, 3.0, 0.2]))])
    points = 1.5 * np.random.default_rng(1).normal(size=(300, 3))
    truth = true_distances(points, mesh.triangles)
    found = Surface.of(mesh.triangles, 5000, np.random.default_rng(2)).distances(points)
    assert (found >= truth - 1e-12).all()
    assert (found - truth).mean() < 1e-3
    on, which = sample_triangles(mesh.triangles, 300, np.random.default_rng(3))
    assert np.allclose(closest_point(mesh.triangles[which], on), on)


def test_overlapping_solids_are_inside_once():
    ball, bar = trimesh.creation.icosphere(4, radius=0.5), trimesh.creation.box([2.0, 0.3, 0.3])
    mesh = merge_meshes([solid(ball), solid(bar)])
    assert closed(mesh)
    low, cell, shape = np.array([-1.2, -0.7, -0.7]), 0.02, (120, 70, 70)
    inside = occupancy(mesh.triangles, low, cell, shape)
    x, y, z = np.moveaxis(low + cell * (np.indices(shape).reshape(3, -1).T + 0.5), 1, 0).reshape(3, *shape)
    radius, beside = np.sqrt(x**2 + y**2 + z**2), np.maximum(np.abs(x) - 1.0, np.maximum(np.abs(y), np.abs(z)) - 0.15)
    sure = (np.abs(radius - 0.5) > 0.01) & (np.abs(beside) > 1e-6)
    assert np.array_equal(inside[sure], ((radius < 0.5) | (beside < 0))[sure])


@pytest.mark.parametrize("shift", [0.0, 0.25])
def test_columns_on_edges_are_crossed_once(shift):
    box = solid(trimesh.creation.box([1.0, 1.0, 1.0]))  # the cells' middles lie on its faces' diagonals
    inside = occupancy(box.triangles, np.full(3, -1.0 + shift * 0.1), 0.1, (20, 20, 20))
    assert inside.sum() == 1000
    assert set(np.unique(inside.sum(2))) == {0, 10}


def test_an_open_surface_is_not_closed():
    box = solid(trimesh.creation.box([1.0, 1.0, 1.0]))
    assert not closed(Mesh(box.vertices, box.faces[1:]))
    assert not closed(Mesh(box.vertices, box.faces[:, ::-1]))


def test_solids_that_share_edges_are_closed():
    """As two boxes of a part that touch do, once vertices at the same place are one."""
    boxes = [solid(trimesh.creation.box([1.0, 1.0, 1.0])).warped(lambda v, x=x: v + x) for x in (0.0, [1.0, 1.0, 0.0])]
    both = merge_meshes(boxes)
    vertices, index = np.unique(both.vertices, axis=0, return_inverse=True)
    welded = Mesh(vertices, index.reshape(-1)[both.faces])
    assert len(welded.vertices) == 14
    assert closed(welded)
    assert not closed(Mesh(welded.vertices, welded.faces[1:]))
