"""Bodies for simulators: convex, hollow, and apart in every state; held to SciPy's linear programming."""

import tracemalloc
from dataclasses import replace
from functools import cache
from itertools import product

import numpy as np
import pytest
import trimesh
from scipy.optimize import linprog
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from omad.data.procedural import generate
from omad.geometry.convex.bodies import ConvexBody, convex_bodies, overlap, united
from omad.geometry.convex.pieces import convex_pieces
from omad.geometry.mesh import Mesh, merge_meshes
from omad.geometry.rigid import rigid
from omad.objects.category_file import get_category
from omad.objects.model import ObjectModel
from omad.objects.urdf import urdf_robot
from omad.output.robots.collision import collision_bodies
from omad.output.robots.robot import DENSITY, Solid


def touch(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether two convex hulls of points (N, 3) have a point in common."""
    planes = np.concatenate([ConvexHull(points).equations for points in (one, other)])
    found = linprog(np.zeros(3), planes[:, :3], -planes[:, 3], bounds=(None, None))
    return found.status == 0


def test_what_was_cut_at_the_gap_is_not_cut_again():
    """Although it was carried there and back, which rounds."""
    rng = np.random.default_rng(0)
    for _ in range(30):
        T = rigid(Rotation.random(random_state=rng).as_matrix(), rng.normal(size=3))
        cube = ConvexBody.around(np.array(list(product((0.0, 0.37), repeat=3))))
        other = ConvexBody.around(cube.vertices + rng.uniform(0, 0.3, 3)).carried(T)
        here = other.carried(np.linalg.inv(T))
        found = overlap(cube, here, 0.002)
        assert found is not None
        left = here.cut(found.normal, found.first_end + 0.002)
        assert left is not None
        assert overlap(cube, left.carried(T).carried(np.linalg.inv(T)), 0.002) is None


def solid(made: trimesh.Trimesh) -> Mesh:
    return Mesh(np.asarray(made.vertices, np.float64), np.asarray(made.faces, np.int64))


@cache
def some_object(name: str) -> tuple[ObjectModel, list[list[ConvexBody]]]:
    """One of a category, and its bodies."""
    model = generate(get_category(name), 1, "test")
    return model, collision_bodies(model)


def test_bodies_that_a_face_separates_do_not_overlap():
    rng, agreed = np.random.default_rng(0), 0
    for _ in range(60):
        one, other = rng.normal(size=(10, 3)), rng.normal(size=(10, 3)) + rng.normal(size=3) * 1.5
        apart = overlap(ConvexBody.around(one), ConvexBody.around(other), 0.0) is None
        assert not (apart and touch(one, other))
        agreed += apart != touch(one, other)
    assert agreed > 50  # in the rest an edge separates from an edge


def test_a_cut_keeps_one_side():
    box = ConvexBody.around(np.array(np.meshgrid([0, 2.0], [0, 1.0], [0, 1.0])).reshape(3, -1).T)
    left = box.cut(np.array([1.0, 0, 0]), 0.5)
    assert left is not None
    assert left.volume == pytest.approx(1.5)
    assert left.vertices[:, 0].min() == pytest.approx(0.5)
    assert box.cut(np.array([1.0, 0, 0]), -1.0) is box
    assert box.cut(np.array([1.0, 0, 0]), 2.5) is None


def test_a_finely_meshed_bowl_needs_little_memory():
    """Heights of all its vertices over all its faces would be 400 MB."""
    turn = np.linspace(0, np.pi / 2, 36)
    arc = np.stack([np.sin(turn), -np.cos(turn)], 1)
    bowl = solid(trimesh.creation.revolve(np.concatenate([arc, 0.9 * arc[::-1]]), sections=72))
    tracemalloc.start()
    try:
        pieces = convex_pieces(bowl.triangles)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert len(pieces) > 10
    assert peak < 100e6


def test_a_ring_stays_open_and_details_are_left_out():
    ring = solid(trimesh.creation.torus(1.0, 0.1, 32, 16))
    bodies = convex_bodies(merge_meshes([ring]), 0.0)
    assert 4 < len(bodies) <= 16
    assert not any(body.holds(np.zeros((1, 3)), 0.0) for body in bodies)
    plate, key = trimesh.creation.box([1, 1, 0.1]), trimesh.creation.box([0.1, 0.1, 0.12])
    both = merge_meshes([solid(plate), solid(key)])
    assert [len(convex_bodies(both, flush)) for flush in (0.02, 0.0)] == [1, 2]


def test_an_open_box_comes_apart_into_its_walls():
    hollow = trimesh.creation.box([0.9, 0.9, 0.95], trimesh.transformations.translation_matrix([0, 0, 0.05]))
    box = trimesh.boolean.difference([trimesh.creation.box([1, 1, 1]), hollow], engine="manifold")
    bodies = convex_bodies(solid(box), 0.0)
    assert len(bodies) == 5
    assert sum(body.volume for body in bodies) == pytest.approx(box.volume, rel=1e-3)
    inside = 0.4 * np.random.default_rng(0).uniform(-1, 1, (200, 3))
    assert not any(body.holds(point[None], 0.0) for body in bodies for point in inside)


def test_what_is_not_closed_is_its_hull():
    lid_off = trimesh.creation.box([1, 1, 1])
    lid_off.update_faces(np.arange(len(lid_off.faces)) > 1)
    (body,) = convex_bodies(solid(lid_off), 0.0)
    assert body.volume == pytest.approx(1)


@pytest.mark.parametrize("name", ["microwave", "lidded_box", "trash_can", "suitcase", "refrigerator", "stapler"])
def test_bodies_fill_no_hollow_and_keep_their_parts(name):
    model, bodies = some_object(name)
    for part, of_part in zip(model.parts, bodies, strict=True):
        volume = trimesh.Trimesh(part.vertices, part.faces, process=False).volume
        assert 0.85 * volume < sum(body.volume for body in of_part) < 1.2 * volume


def test_room_is_made_for_possible_states_alone():
    stapler = generate(get_category("stapler"), 1, "test")
    states = np.array([[0.0, 0.0], [0.5, 0.5], [0.5, 0.6], [0.0, 0.1]])
    assert stapler.possible(states).tolist() == [True, True, False, False]
    assert stapler.possible(states, [1]).all()
    kept, free = (
        sum(body.volume for body in collision_bodies(model)[0]) for model in (stapler, replace(stapler, at_most=()))
    )
    assert kept > 1.2 * free


@pytest.mark.parametrize("name", ["laptop", "dishwasher", "drawer", "scissors"])
def test_parts_never_touch(name):
    (model, bodies), rng = some_object(name), np.random.default_rng(0)
    for states in [np.clip(0, *model.limits.T), *model.limits.T, *(rng.uniform(*model.limits.T) for _ in range(3))]:
        placed = [
            [body.carried(T) for body in of_part]
            for of_part, T in zip(bodies, model.part_transforms(states), strict=True)
        ]
        for k, second in enumerate(placed):
            for first in placed[:k]:
                for a in first:
                    near = [b for b in second if overlap(a, b, 0.0) is not None]
                    assert not any(touch(a.vertices, b.vertices) for b in near)
    kept = [sum(body.volume for body in of_part) for of_part in bodies]
    whole = [sum(body.volume for body in convex_bodies(part, 0.008 * model.diagonal)) for part in model.parts]
    assert (np.array(kept) > 0.6 * np.array(whole)).all()


def test_a_cabinet_is_hollow():
    model, (cabinet, *_) = some_object("drawer")
    drawers = model.parts[1:]
    for drawer in drawers:
        middle = drawer.vertices.mean(0)[None] - [[0.0, 0.0, 0.2 * model.diagonal]]
        assert not any(body.holds(middle, 0.0) for body in cabinet)


def test_the_urdf_has_a_collision_a_body(tmp_path):
    model, of_parts = some_object("laptop")
    bodies = [[body.mesh for body in of_part] for of_part in of_parts]
    root = urdf_robot(model, tmp_path / "object.urdf", bodies)
    for link, of_part in zip(root.findall("link"), bodies, strict=True):
        files = [element.find("geometry/mesh").get("filename") for element in link.findall("collision")]
        assert len(link.findall("visual")) == 1
        assert len(files) == len(set(files)) == len(of_part)
        loaded = [trimesh.load(tmp_path / file, process=False) for file in files]
        assert all(mesh.is_convex for mesh in loaded)


@pytest.mark.parametrize(("apart", "volume"), [(0.5, 1.5), (1.0, 2.0), (3.0, 2.0), (0.25, 1.25)])
def test_what_two_solids_share_weighs_once(apart: float, volume: float):
    cube = solid(trimesh.creation.box([1, 1, 1]))
    both = merge_meshes([cube, cube.warped(lambda vertices: vertices + [apart, 0, 0])])
    found = Solid.of(both)
    assert found.mass == pytest.approx(volume * DENSITY)
    np.testing.assert_allclose(found.centre, [apart / 2, 0, 0], atol=1e-9)
    if apart < 2:
        as_one = trimesh.creation.box([volume, 1, 1]).moment_inertia
        np.testing.assert_allclose(found.inertia, as_one * DENSITY, rtol=1e-6, atol=1e-6)


def test_what_is_not_closed_weighs_as_it_did():
    open_box = solid(trimesh.creation.box([1, 1, 1]))
    np.testing.assert_array_equal(united(replace(open_box, faces=open_box.faces[1:])).faces, open_box.faces[1:])
