"""The z-buffer against ray casting, and against what geometry says exactly."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy import ndimage

from helpers.categories import EVERY
from omad.data.procedural import generate
from omad.data.rendering.rasteriser import NEAR, NOTHING, Rendering, rasterise, render
from omad.data.rendering.standard_views import standard_view
from omad.geometry.camera import STANDARD_CAMERA, Camera
from omad.geometry.mesh import Mesh

CAMERA = Camera(160, 120, 150.0, 140.0, 83.3, 57.1)


def cast(vertices: np.ndarray, faces: np.ndarray, labels: np.ndarray, camera: Camera) -> Rendering:
    """The oracle: one Embree ray through every pixel centre."""
    ray = pytest.importorskip("trimesh.ray.ray_pyembree")
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    v, u = np.indices((camera.height, camera.width)).reshape(2, -1)
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(len(u))], 1)
    triangle = ray.RayMeshIntersector(mesh, scale_to_box=False).intersects_first(np.zeros_like(rays), rays)
    hit = triangle >= 0
    normal = np.cross(*(mesh.triangles[:, i] - mesh.triangles[:, 0] for i in (1, 2)))[triangle]
    along = np.einsum("pi,pi->p", normal, rays)
    depth = np.einsum("pi,pi->p", normal, mesh.triangles[triangle, 0]) / np.where(hit, along, 1.0)
    cosine = np.abs(along) / np.linalg.norm(normal, axis=1) / np.linalg.norm(rays, axis=1)
    shape = (camera.height, camera.width)
    return Rendering(
        np.where(hit, depth, 0).reshape(shape),
        np.where(hit, labels[triangle], NOTHING).astype(np.uint8).reshape(shape),
        np.where(hit, cosine, 0).reshape(shape),
    )


def assert_same(ours: Rendering, oracle: Rendering) -> None:
    """Depth to 0.1 mm and labels, but for pixels on an outline, where the two may round differently."""
    differ = (np.abs(ours.depth - oracle.depth) > 1e-4) | (ours.labels != oracle.labels)
    far, near = (f(oracle.depth, 3) for f in (ndimage.maximum_filter, ndimage.minimum_filter))
    outline = (far - near > 0.01) | (
        ndimage.maximum_filter(oracle.labels, 3) != ndimage.minimum_filter(oracle.labels, 3)
    )
    assert not (differ & ~outline).any()
    seen = max((oracle.depth > 0).sum(), 1)
    assert differ.sum() / seen < 2e-3
    assert np.abs(ours.cos_view - oracle.cos_view)[~differ & ~outline].max(initial=0) < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("name", ["drawer", "eyeglasses", "jar", "laptop", "lidded_box", "scissors"])
def test_procedural_objects_look_as_rays_see_them(name: str) -> None:
    category = EVERY[name]
    for index in range(4):
        model = generate(category, index, "test")
        view = standard_view(model, category, (5, index))
        posed = model.posed_vertices(view.states, view.T_camera_base)
        merged = trimesh.util.concatenate(
            [trimesh.Trimesh(v, p.faces, process=False) for v, p in zip(posed, model.parts, strict=True)]
        )
        labels = np.repeat(np.arange(len(posed)), [len(p.faces) for p in model.parts])
        oracle = cast(merged.vertices, merged.faces, labels, STANDARD_CAMERA)
        assert_same(render(model, view.states, view.T_camera_base, STANDARD_CAMERA), oracle)


@pytest.mark.parametrize("seed", range(8))
def test_random_triangle_soup(seed: int) -> None:
    """Intersecting, behind, beside and across the camera, of any orientation."""
    rng = np.random.default_rng(seed)
    centres = rng.uniform((-2, -2, -1), (2, 2, 4), (60, 1, 3))
    vertices = (centres + rng.normal(0, 0.5, (60, 3, 3))).reshape(-1, 3)
    faces, labels = np.arange(180).reshape(60, 3), np.arange(60)
    assert_same(rasterise(vertices, faces, labels, CAMERA), cast(vertices, faces, labels, CAMERA))


def test_plane_has_its_exact_depth_at_pixel_centres() -> None:
    corners = (
        np.array([[-5, -5, 0], [5, -5, 0], [5, 5, 0], [-5, 5, 0]])
        @ trimesh.transformations.euler_matrix(0.5, 0.3, 0)[:3, :3].T
    )
    corners[:, 2] += 3
    ours = rasterise(corners, np.array([[0, 1, 2], [0, 3, 2]]), np.zeros(2), CAMERA)
    normal = np.cross(corners[1] - corners[0], corners[3] - corners[0])
    v, u = np.indices((120, 160))
    expected = (
        normal
        @ corners[0]
        / (normal[0] * (u - CAMERA.cx) / CAMERA.fx + normal[1] * (v - CAMERA.cy) / CAMERA.fy + normal[2])
    )
    assert (ours.labels == 0).all()
    assert np.allclose(ours.depth, expected, rtol=1e-6)


def test_shared_edges_have_no_cracks() -> None:
    """A wall of many triangles with corners exactly on pixel centres, and at random places."""
    camera = Camera(64, 64, 64.0, 64.0, 32.0, 32.0)
    rng = np.random.default_rng(0)
    for jitter in (0.0, 0.01):
        u, v = np.meshgrid(np.linspace(-1, 1, 33), np.linspace(-1, 1, 33))
        points = np.stack([u, v, np.ones_like(u)], -1) + jitter * rng.uniform(-1, 1, (33, 33, 3)) * (1, 1, 0)
        index = np.arange(33 * 33).reshape(33, 33)
        quads = [index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]]
        faces = np.concatenate([np.stack([quads[a] for a in tri], -1).reshape(-1, 3) for tri in ((0, 1, 2), (0, 2, 3))])
        ours = rasterise(points.reshape(-1, 3), faces, np.zeros(len(faces)), camera)
        assert (ours.depth > 0).all()


def test_surfaces_that_cross_the_near_plane_are_cut_there() -> None:
    floor = np.array([[-3.0, 1, -2], [3, 1, -2], [0, 1, 50]])
    ours = rasterise(floor, np.array([[0, 1, 2]]), np.zeros(1), CAMERA)
    v, _ = np.nonzero(ours.depth)
    assert len(v) > 1000
    assert np.allclose(ours.depth[ours.depth > 0], CAMERA.fy / (v - CAMERA.cy), rtol=1e-5)
    behind = rasterise(floor - (0, 0, 60), np.array([[0, 1, 2]]), np.zeros(1), CAMERA)
    assert not behind.depth.any()
    assert (behind.labels == NOTHING).all()
    touching = rasterise(
        np.array([[-3.0, 1, NEAR], [3, 1, NEAR], [0, 1, 50]]), np.array([[0, 1, 2]]), np.zeros(1), CAMERA
    )
    assert np.isfinite(touching.depth).all()


def test_degenerate_triangles_and_empty_meshes_show_nothing() -> None:
    point = np.array([[0.0, 0, 1], [0, 0, 1], [0, 0, 1], [1, 0, 2]])
    assert not rasterise(point, np.array([[0, 1, 2], [0, 1, 3]]), np.zeros(2), CAMERA).depth.any()
    assert not rasterise(point, np.zeros((0, 3), dtype=int), np.zeros(0), CAMERA).depth.any()


def test_one_part_hides_another_and_both_sides_of_a_face_are_seen() -> None:
    def square(z: float, size: float) -> Mesh:
        corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * size
        return Mesh(np.column_stack([corners, np.full(4, z)]), np.array([[0, 1, 2], [0, 2, 3]]))

    front, back = square(1.0, 0.1), square(2.0, 0.5)
    for order in (1, -1):
        vertices = np.concatenate([front.vertices, back.vertices])
        faces = np.concatenate([front.faces, back.faces + 4])[:, ::order]
        ours = rasterise(vertices, faces, np.array([0, 0, 1, 1]), CAMERA)
        centre = (57, 83)
        assert ours.labels[centre] == 0
        assert ours.depth[centre] == pytest.approx(1.0)
        assert set(np.unique(ours.labels)) == {0, 1, NOTHING}


@pytest.mark.slow
@pytest.mark.skipif("OMAD_MODELS" not in os.environ, reason="OMAD_MODELS names no folder of real models")
def test_scanned_and_modelled_meshes_look_as_rays_see_them() -> None:
    """Foreign meshes: open, doubled and badly wound faces, many slivers."""
    folders = sorted(Path(os.environ["OMAD_MODELS"]).glob("*/*/textured_objs"))[:6]
    assert folders
    for index, folder in enumerate(folders):
        parts = [trimesh.load_mesh(path, process=False) for path in sorted(folder.glob("*.obj"))]
        mesh = trimesh.util.concatenate([trimesh.Trimesh(p.vertices, p.faces, process=False) for p in parts])
        pose = trimesh.transformations.euler_matrix(2.7, 0.5 * index, 0.1)
        pose[:3, 3] = 0, 0, 3
        vertices, labels = trimesh.transform_points(mesh.vertices, pose), np.zeros(len(mesh.faces), dtype=int)
        ours = rasterise(vertices, mesh.faces, labels, STANDARD_CAMERA)
        oracle = cast(vertices, mesh.faces, labels, STANDARD_CAMERA)
        seen = (ours.depth > 0) & (oracle.depth > 0)
        assert seen.sum() > 10_000
        assert ((ours.depth > 0) != (oracle.depth > 0)).sum() < 2e-3 * seen.sum()
        assert (np.abs(ours.depth - oracle.depth)[seen] > 1e-4).mean() < 2e-3
