"""Real models: they move as another reader moves them, lie as the category asks, and others are refused."""

import os
from pathlib import Path

import numpy as np
import pytest
import trimesh
import yourdfpy
from scipy.spatial.transform import Rotation

from helpers.categories import CHEST, DISHWASHER, EVERY, LAPTOP
from helpers.kinematics_by_yourdfpy import largest_gap, vertices_of
from helpers.same_models import assert_same
from omad.common.errors import InputError
from omad.data.procedural import generate
from omad.data.urdf_import.articulation import read_articulation, read_urdf
from omad.data.urdf_import.folder import import_model, import_with_notes, load_folder
from omad.data.urdf_import.links import label_parts
from omad.objects.model import ObjectModel
from omad.objects.urdf import write_urdf

MODELS = Path(os.environ.get("OMAD_MODELS", "nowhere"))
needs_models = pytest.mark.skipif(not MODELS.is_dir(), reason="OMAD_MODELS names no folder of real models")
REAL = [("laptop/arctic", LAPTOP)] + [(f"dishwasher/{i}", DISHWASHER) for i in (11622, 11826, 12259)]


def rigid(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The 4x4 transform that takes points ``a`` to ``b``."""
    T = np.eye(4)
    T[:3, :3] = Rotation.align_vectors(b - b.mean(0), a - a.mean(0))[0].as_matrix()
    T[:3, 3] = b.mean(0) - T[:3, :3] @ a.mean(0)
    return T


@pytest.mark.slow
@needs_models
@pytest.mark.parametrize(("name", "category"), REAL)
def test_real_models_move_as_another_reader_moves_them(name, category):
    """One fixed transform takes another reader's points to ours, at every state."""
    model = import_model(MODELS / name, category)
    file = next((MODELS / name).glob("*.urdf"))
    scale = category.metres_per_unit if file.name == "mobility.urdf" else 1.0
    robot = yourdfpy.URDF.load(str(file))
    (hinge,) = (joint for joint in robot.actuated_joints if joint.type == "revolute")
    racks = {j.name: j.limit.lower for j in robot.actuated_joints if j.type == "prismatic"}

    # the vertices' correspondence and the zero state come from our own reading, the motion from theirs
    (raw,) = next(label_parts(read_articulation(file, scale), category))
    T = rigid(raw.links[0].mesh.vertices, model.parts[0].vertices)
    to_rest = np.linalg.inv(T) @ rigid(raw.links[1].mesh.vertices, model.parts[1].vertices)
    rest = Rotation.from_matrix(to_rest[:3, :3]).as_rotvec() @ raw.joints[0].axis
    sign = float(np.sign(T[:3, :3] @ raw.joints[0].axis @ model.axes[0]))

    for state in np.random.default_rng(0).uniform(*model.limits[0], 3):
        robot.update_cfg({**racks, hinge.name: rest + sign * state})
        links = [link.name for link in robot.robot.links if link.visuals]
        base = np.concatenate([vertices_of(robot, link) for link in links if link != hinge.child])
        theirs = [scale * base, scale * vertices_of(robot, hinge.child)]
        for a, b in zip(theirs, model.posed_vertices(np.array([state])), strict=True):
            assert largest_gap(a @ T[:3, :3].T + T[:3, 3], b) < 1e-6 * model.diagonal


@pytest.mark.slow
@needs_models
@pytest.mark.parametrize(("name", "category"), REAL)
def test_real_models_are_canonical(name, category):
    model = import_model(MODELS / name, category)
    boxes = model.part_boxes()
    np.testing.assert_allclose(boxes[:, 0].min(0), -boxes[:, 1].max(0), atol=1e-9)
    np.testing.assert_allclose(model.axes, [[1, 0, 0]], atol=1e-6)
    np.testing.assert_allclose(model.limits, [category.joints[0].limits], atol=1e-6)
    base, child = boxes.mean(1)
    size = np.ptp(boxes, axis=1)
    if category is LAPTOP:
        assert child[1] > base[1]
        assert child[2] < base[2]
        assert size[0, 1] < 0.03
        assert size[1, 2] < 0.03
        assert 0.25 < size[0, 0] < 0.45
        # both panels stand along the axes: the thin side of the smallest box around each, found by hull search
        for part, thin in zip(model.parts, ([0, 1, 0], [0, 0, 1]), strict=True):
            to_origin, extents = trimesh.bounds.oriented_bounds(part.vertices)
            normal = to_origin[:3, :3][extents.argmin()]
            assert abs(normal @ thin) > np.cos(np.radians(1.0))
    else:
        assert child[2] > base[2] + 0.15
        assert 0.4 < size[0, 0] < 0.7
        # opening brings the door's top edge forward and down
        door = model.posed_vertices(model.limits[:, 1])[1]
        assert door[:, 2].max() > boxes[:, 1, 2].max() + 0.4
        assert door[:, 1].max() < base[1]


@pytest.mark.slow
@needs_models
def test_real_models_survive_our_own_writer(tmp_path):
    for name, category in REAL:
        model = import_model(MODELS / name, category)
        assert_same(read_urdf(write_urdf(model, tmp_path / name), category), model, 1e-9, 1e-12)


@needs_models
def test_real_models_of_another_kind_are_refused():
    drawers = load_folder(MODELS / "drawer", DISHWASHER)
    assert not drawers.models
    reasons = {refusal.name: refusal.reason for refusal in drawers.refused}
    assert "'Table'" in reasons["23724"]
    assert "'StorageFurniture'" in reasons["45261"]
    assert "revolute" in reasons["mk_station"]
    with pytest.raises(InputError, match="'Microwave'"):
        import_model(MODELS / "microwave" / "7221", DISHWASHER)
    for name in ("101284", "101287"):
        with pytest.raises(InputError, match="'Eyeglasses'"):
            import_model(MODELS / "eyeglasses" / name, LAPTOP)
    with pytest.raises(InputError, match="drawer"):
        import_model(MODELS / "drawer" / "45261", CHEST)


WITHIN = {
    "microwave": ("microwave", "7119", "7128", "7167"),
    "oven": ("oven", "101940"),
    "refrigerator": ("refrigerator", "10849", "12249"),
    "refrigerator_two_doors": ("refrigerator", "11178", "11299"),
    "cabinet_one_door": ("cabinet", "45526", "46197", "46236"),
    "drawer_2": ("cabinet", "45746"),
    "drawer_5": ("drawer", "45261"),
    "lidded_box": ("box", "100189"),
    "trash_can": ("trashcan", "11361"),
    "stapler": ("stapler", "103100", "103104"),
}
"""By shipped categories: a folder, and what in it is of the category."""
OTHER_HAND = {"10849", "12249", "46197", "46236"}
"""Doors hinged at the right."""


@pytest.mark.slow
@needs_models
@pytest.mark.parametrize("name", WITHIN)
def test_real_models_are_within_what_is_generated(name):
    """Sizes of parts and places of hinges, as shares of the object's diagonal."""
    category, (folder, *names) = EVERY[name], WITHIN[name]
    made = np.stack([_proportions(generate(category, index)) for index in range(150)])
    low, high = made.min(0), made.max(0)
    for each in names:
        imported = import_with_notes(MODELS / folder / each, category)
        found = _proportions(imported.model)
        assert (found > low - 0.05).all(), (each, found, low)
        assert (found < high + 0.05).all(), (each, found, high)
        assert any("mirror image" in note for note in imported.notes) == (each in OTHER_HAND)


def _proportions(model: ObjectModel) -> np.ndarray:
    """Extents of all parts, and pivots without what is along their axes."""
    boxes = model.part_boxes()
    along = (model.pivots * model.axes).sum(1, keepdims=True) * model.axes
    return np.concatenate([(boxes[:, 1] - boxes[:, 0]).ravel(), (model.pivots - along).ravel()]) / model.diagonal
