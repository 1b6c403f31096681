"""Models of categories that the package does not know, as a user might have them: boxes, z up, in any place."""

from pathlib import Path

import numpy as np
import trimesh

from omad.geometry.joint_kinds import REVOLUTE, motion_of
from omad.geometry.kinematics import KinematicTree
from omad.geometry.mesh import Mesh, merge_meshes
from omad.objects.model import ObjectModel
from omad.objects.urdf import write_urdf

SPECS = Path(__file__).parents[2] / "docs" / "categories"
"""Folder of their categories' specs."""
Z_UP = np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""Canonical space to the frame of these files: front along -x, up along z."""


def box(low, high) -> Mesh:
    solid = trimesh.creation.box(bounds=[low, high])
    return Mesh(np.array(solid.vertices), np.array(solid.faces))


def microwave(name: str = "made", width: float = 0.5, height: float = 0.28, depth: float = 0.35) -> ObjectModel:
    w, h, d = width / 2, height / 2, depth / 2
    split = 0.55 * w
    return ObjectModel(
        name=name,
        category="my_microwave",
        part_names=("body", "door"),
        parts=(box((-w, -h, -d), (w, h, d - 0.03)), box((-w, -h, d - 0.03), (split, h, d))),
        joint_names=("door_joint",),
        tree=KinematicTree((0,), (REVOLUTE,)),
        axes=np.array([[0.0, -1.0, 0.0]]),
        pivots=np.array([[-w, 0.0, d - 0.03]]),
        limits=np.array([[0.0, np.pi / 2]]),
    ).centred()


def stapler(name: str = "made", length: float = 0.15, width: float = 0.03) -> ObjectModel:
    back, front, w = -length / 2, length / 2, width / 2
    return ObjectModel(
        name=name,
        category="my_stapler",
        part_names=("base", "lid", "magazine"),
        parts=(
            box((-w, 0.0, back), (w, 0.01, front)),
            box((-w, 0.03, back), (w, 0.05, front - 0.01)),
            box((-0.7 * w, 0.02, back), (0.7 * w, 0.03, front - 0.02)),
        ),
        joint_names=("lid_joint", "magazine_joint"),
        tree=KinematicTree((0, 1), (REVOLUTE, REVOLUTE)),
        axes=np.array([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]]),
        pivots=np.array([[0.0, 0.02, back], [0.0, 0.03, back]]),
        limits=np.radians([[0.0, 100.0], [0.0, 90.0]]),
    ).centred()


JAR_PITCH = 0.03
"""Metres a turn."""
JAR = f"""
name = "my_jar"
metres_per_unit = 0.1
basis_size = 4

[[parts]]
name = "jar"
keypoints = 8

[[parts]]
name = "lid"
keypoints = 8
joint = {{ type = "screw", pitch = {JAR_PITCH}, axis = "+y", limits = [0, 540], side = "+y", rest = "zero" }}
"""
"""Spec file of a jar with a lid that turns and rises."""


def jar(name: str = "made", width: float = 0.09, height: float = 0.12, lid: float = 0.03) -> ObjectModel:
    """A square jar; the lid has a wing on one side, so that a view shows how far it has turned."""
    w, wing = width / 2, (0.6 * width, height + lid)
    return ObjectModel(
        name=name,
        category="my_jar",
        part_names=("jar", "lid"),
        parts=(
            box((-w, 0.0, -w), (w, height, w)),
            merge_meshes(
                [
                    box((-0.9 * w, height, -0.9 * w), (0.9 * w, height + lid, 0.9 * w)),
                    box((0.0, height + 0.3 * lid, -0.2 * w), (wing[0], wing[1], 0.2 * w)),
                ]
            ),
        ),
        joint_names=("lid_joint",),
        tree=KinematicTree((0,), (motion_of("screw", JAR_PITCH),)),
        axes=np.array([[0.0, 1.0, 0.0]]),
        pivots=np.zeros((1, 3)),
        limits=np.array([[0.0, 3 * np.pi]]),
    ).centred()


def write_jars(folder: Path, count: int, seed: int = 0) -> None:
    rng = np.random.default_rng(seed)
    for index in range(count):
        made = jar(f"jar-{seed}-{index}", *rng.uniform((0.07, 0.1, 0.02), (0.1, 0.14, 0.04)))
        write_urdf(made, folder / made.name / f"{made.name}.urdf")


def seen_from_elsewhere(model: ObjectModel, states: np.ndarray, shift=(0.3, -0.2, 0.5)) -> ObjectModel:
    """The same object z up, somewhere, and with its joints' zero at ``states`` (J,)."""
    T = model.part_transforms(states)
    parents = list(model.tree.parents)
    axes = np.einsum("jab,jb->ja", T[parents, :3, :3], model.axes)
    pivots = np.einsum("jab,jb->ja", T[parents, :3, :3], model.pivots) + T[parents, :3, 3]
    return ObjectModel(
        name=model.name,
        category=model.category,
        part_names=model.part_names,
        parts=tuple(
            Mesh(v @ Z_UP.T + shift, part.faces)
            for v, part in zip(model.posed_vertices(states), model.parts, strict=True)
        ),
        joint_names=model.joint_names,
        tree=model.tree,
        axes=axes @ Z_UP.T,
        pivots=pivots @ Z_UP.T + shift,
        limits=model.limits - states[:, None],
    )


def write_microwaves(folder: Path, count: int, seed: int = 0) -> None:
    rng = np.random.default_rng(seed)
    for index in range(count):
        made = microwave(f"oven-{seed}-{index}", *rng.uniform((0.45, 0.25, 0.3), (0.55, 0.32, 0.4)))
        write_urdf(seen_from_elsewhere(made, rng.uniform(0, 1, 1)), folder / made.name / f"{made.name}.urdf")


def write_staplers(folder: Path, count: int, seed: int = 0) -> None:
    rng = np.random.default_rng(seed)
    for index in range(count):
        made = stapler(f"stapler-{seed}-{index}", *rng.uniform((0.12, 0.02), (0.18, 0.04)))
        write_urdf(seen_from_elsewhere(made, rng.uniform(0, 0.8, 2)), folder / made.name / f"{made.name}.urdf")
