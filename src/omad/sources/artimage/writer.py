"""Write views of object models in ArtImage's layout, so that whatever reads the original reads them.

The model frame of an object is canonical space in category units, and its rest state is zero. Objects whose name is
a number keep it as their id, and belong to the split of that id; all others are numbered.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ...camera import STANDARD_CAMERA, Camera
from ...categories import Category
from ...depth_noise import NoiseLevel
from ...errors import InputError
from ...files import write_atomic
from ...objects import ObjectModel
from ...standard_views import View, standard_view
from ...view_folder import draw_missing, write_json, write_png
from .layout import DEPTH_STEP, SPLITS, Layout, Split, peculiarities, read_json

FIRST_ID = {"train": 1_000_000, "test": 2_000_000}
"""Of the objects without an id; no model collection counts so far."""
POINTS = 4000
"""Surface points a part."""


def write_artimage(
    models: Sequence[ObjectModel],
    category: Category,
    root: Path | str,
    views: int,
    split: Split,
    seed: int = 0,
    noise: NoiseLevel | None = None,
    processes: int = 1,
    progress: bool = False,
) -> Layout:
    """Write ``views`` standard views of the models; what is already there from the same arguments is kept.

    ``split`` is that of objects without an id of their own. Another call adds another split, or another category.
    Raises InputError for a folder made with other arguments (only ``views`` may differ), and for a category whose
    parts do not all hang on the base.
    """
    if any(joint.parent for joint in category.joints):
        raise InputError(f"ArtImage's layout hangs every part on the base; those of a {category.name} do not")
    layout = Layout(Path(root), category.name)
    ids = [_object_id(model, index, split) for index, model in enumerate(models)]
    if not ids or len(set(ids)) < len(ids):
        raise InputError(f"{root}: rendering needs object models, each with an id of its own; got {ids}")
    splits: dict[str, Split] = {name: _split_of(name, category, split) for name in ids}
    written: list[Split] = [chosen for chosen in SPLITS if chosen in splits.values()]
    intrinsics = {"intrinsic_matrix": STANDARD_CAMERA.K.T.ravel().tolist()}
    records: list[tuple[Path, dict[str, Any]]] = [(layout.camera, {**_size(STANDARD_CAMERA), **intrinsics})]
    for chosen in written:
        names = {name: model.name for name, model in zip(ids, models, strict=True) if splits[name] == chosen}
        settings = {"seed": seed, "noise": asdict(noise) if noise else None, "objects": names}
        records.append((_record_path(layout, chosen), settings))
    for path, record in records:
        _check_same(path, record)
    for path, record in records:
        write_json(path, record)
    for name, model in zip(ids, models, strict=True):
        _write_object(layout, name, model, category)
    _write_rest_states(layout, category)
    job = _Job(layout, tuple(models), tuple(ids), category, noise)
    draw_missing(job, views, seed, processes, progress)
    drawn = [(ids[index % len(ids)], job.name(index % len(ids), index // len(ids))) for index in range(views)]
    for chosen in SPLITS:
        if chosen in written or not layout.valid(chosen).exists():
            _write_text(layout.valid(chosen), "".join(f"{file}\n" for name, file in drawn if splits[name] == chosen))
    return layout


@dataclass(frozen=True)
class _Job:
    layout: Layout
    models: tuple[ObjectModel, ...]
    ids: tuple[str, ...]
    category: Category
    noise: NoiseLevel | None

    def name(self, index: int, number: int) -> str:
        return f"{self.ids[index]}_{number:04d}.json"

    def marker(self, seed: tuple[int, int, int]) -> Path:
        return self.layout.annotation(self.name(*seed[1:]))

    def write(self, seed: tuple[int, int, int]) -> None:
        """Draw one view and write depth, mask and, last, annotation."""
        model, target = self.models[seed[1]], self.marker(seed)
        view = standard_view(model, self.category, seed, self.noise)
        stored = np.rint(view.depth / (DEPTH_STEP * self.category.metres_per_unit))
        stored = np.where(stored < 2**16, stored, 0).astype(np.uint16)
        depth_path = Path("depth") / f"{target.stem}.png"
        write_png(self.layout.images / depth_path, stored)
        mask = np.where(stored > 0, view.labels, np.uint8(0))
        write_png(self.layout.images / "category_mask" / depth_path.name, np.repeat(mask[..., None], 3, 2))
        links = _links(model, view, self.category)
        instance = {"urdf_id": int(self.ids[seed[1]]), "bbox": _box(stored), "links": links}
        write_json(target, {**_size(view.camera), "depth_path": depth_path.as_posix(), "instances": [instance]})


def _size(camera: Camera) -> dict[str, int]:
    return {"width": camera.width, "height": camera.height}


def _object_id(model: ObjectModel, index: int, split: Split) -> str:
    return str(int(model.name)) if model.name.isdecimal() else str(FIRST_ID[split] + index)


def _split_of(name: str, category: Category, split: Split) -> Split:
    known = peculiarities(category).test_objects
    if not known or int(name) >= min(FIRST_ID.values()):
        return split
    return "test" if name in known else "train"


def _record_path(layout: Layout, split: Split) -> Path:
    """What a split was written with, so that nothing else is mixed into it."""
    return layout.folder / f"render_{split}.json"


def _check_same(path: Path, record: dict[str, Any]) -> None:
    before = read_json(path) if path.exists() else record
    for key, value in record.items():
        if before.get(key) != value:
            raise InputError(f"{path}: already holds another {key}; choose another folder or delete it")


def _links(model: ObjectModel, view: View, category: Category) -> list[dict[str, Any]]:
    """Pose of every part and state of every child, as annotations have them."""
    transforms = model.part_transforms(view.states, view.T_camera_base)
    transforms[:, :3, 3] /= category.metres_per_unit
    links: list[dict[str, Any]] = [{"link_category_id": 0, "transformation": transforms[0].tolist()}]
    for index, joint in enumerate(category.joints):
        theta = float(view.states[index])
        state = -math.degrees(theta) if joint.type == "revolute" else theta / category.metres_per_unit
        transformation = transforms[index + 1].tolist()
        links.append({"link_category_id": index + 1, "state": state, "transformation": transformation})
    return links


def _box(stored: np.ndarray) -> list[int]:
    """x1, y1, x2, y2 around what is measured, half-open; of an empty image, all of it."""
    rows, columns = np.nonzero(stored)
    if not len(rows):
        return [0, 0, stored.shape[1], stored.shape[0]]
    return [int(columns.min()), int(rows.min()), int(columns.max()) + 1, int(rows.max()) + 1]


def _write_object(layout: Layout, name: str, model: ObjectModel, category: Category) -> None:
    """URDFs and points. Raises InputError where another object of this id is there already."""
    urdf = _urdf(model, category)
    _write_same(layout.aligned_urdf(name), urdf)
    _write_same(layout.plain_urdf(name), urdf)
    for part, mesh in enumerate(model.parts):
        rng = np.random.default_rng([int(name), part])
        corners = np.concatenate([mesh.vertices.argmin(0), mesh.vertices.argmax(0)])  # so that boxes are exact
        drawn = replace(model, parts=(mesh,)).surface_samples(POINTS - len(corners), rng).points
        points = np.concatenate([mesh.vertices[corners], drawn]) / category.metres_per_unit
        lines = [f"{x:.9f} {y:.9f} {z:.9f}\n" for x, y, z in points.tolist()]
        _write_same(layout.points(name, part), "".join(lines))


def _urdf(model: ObjectModel, category: Category) -> str:
    """Joints alone: a triple (x, y, z) is written "z x y", and limits in degrees or units."""
    robot = ElementTree.Element("robot", name=model.name)
    for link in ("base", *map(str, range(len(model.parts)))):
        ElementTree.SubElement(robot, "link", name=link)
    fixed = ElementTree.SubElement(robot, "joint", name="joint_0", type="fixed")
    ElementTree.SubElement(fixed, "origin", xyz="0 0 0", rpy="0 0 0")
    ElementTree.SubElement(fixed, "parent", link="base")
    ElementTree.SubElement(fixed, "child", link="0")
    for index, kind in enumerate(model.tree.types):
        joint = ElementTree.SubElement(robot, "joint", name=f"joint_{index + 1}", type=kind)
        ElementTree.SubElement(joint, "origin", xyz=_triple(model.pivots[index] / category.metres_per_unit))
        ElementTree.SubElement(joint, "axis", xyz=_triple(model.axes[index]))
        ElementTree.SubElement(joint, "parent", link="0")
        ElementTree.SubElement(joint, "child", link=str(index + 1))
        limits = model.limits[index]
        low, high = np.degrees(limits) if kind == "revolute" else limits / category.metres_per_unit
        ElementTree.SubElement(joint, "limit", lower=repr(float(low)), upper=repr(float(high)))
    ElementTree.indent(robot)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(robot, encoding="unicode") + "\n"


def _triple(vector: np.ndarray) -> str:
    return " ".join(repr(float(value) + 0.0) for value in vector[[2, 0, 1]])


def _write_rest_states(layout: Layout, category: Category) -> None:
    """The objects stand at rest as they are: those of every split that is there."""
    records = [read_json(path) for path in (_record_path(layout, split) for split in SPLITS) if path.exists()]
    ids = sorted(name for record in records for name in record["objects"])
    write_json(
        layout.rest_states, {name: {str(k): {"state": 0.0} for k in range(1, len(category.parts))} for name in ids}
    )


def _write_same(path: Path, text: str) -> None:
    if path.exists() and path.read_text(encoding="utf-8") != text:
        raise InputError(f"{path}: already there, of another object; choose another folder or delete it")
    _write_text(path, text)


def _write_text(path: Path, text: str) -> None:
    write_atomic(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))
