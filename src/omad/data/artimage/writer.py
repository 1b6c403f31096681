"""Write views of object models in ArtImage's layout, so that whatever reads the original reads them.

The model frame of an object is canonical space in category units, and its rest state is zero. Objects whose name is
a number keep it as their id, and belong to the split of that id; all others are numbered.
"""

import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from omad.common.errors import InputError
from omad.common.files import write_json, write_text
from omad.common.incoming import read_json
from omad.geometry.camera import STANDARD_CAMERA, Camera
from omad.geometry.joint_kinds import type_of
from omad.objects.category import Category
from omad.objects.model import ObjectModel
from omad.objects.urdf import urdf_numbers, xml_text

from ..rendering.depth_noise import NoiseLevel
from ..rendering.standard_views import View, ViewSeed, view_seed
from ..rendering.stored_images import write_depth, write_png
from ..rendering.view_folder import draw_missing, make_standard, refuse_others
from .layout import AGAIN, SPLITS, Layout, Split, depth_step, peculiarities, require_flat_tree

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
    require_flat_tree(category)
    layout = Layout(Path(root), category.name)
    numbers = (int(m.name) if m.name.isdecimal() else FIRST_ID[split] + i for i, m in enumerate(models))
    ids = [*map(str, numbers)]
    if not ids or len(set(ids)) < len(ids):
        raise InputError(f"{root}: rendering needs object models, each with an id of its own; got {ids}")
    splits: dict[str, Split] = {name: _split_of(name, category, split) for name in ids}
    written: list[Split] = [chosen for chosen in SPLITS if chosen in splits.values()]
    intrinsics = {"intrinsic_matrix": STANDARD_CAMERA.K.T.ravel().tolist()}
    records: dict[Path, dict[str, Any]] = {layout.camera: {**_size(STANDARD_CAMERA), **intrinsics}}
    for chosen in written:
        names = {name: model.name for name, model in zip(ids, models, strict=True) if splits[name] == chosen}
        settings = {"seed": seed, "noise": asdict(noise) if noise else None, "objects": names}
        records[_record_path(layout, chosen)] = settings
    for path, record in records.items():
        if path.exists():
            refuse_others(path, read_json(path, AGAIN), record)
    for path, record in records.items():
        write_json(path, record)
    for name, model in zip(ids, models, strict=True):
        _write_object(layout, name, model, category)
    _write_rest_states(layout, category)
    writer = _ViewWriter(layout, tuple(models), tuple(ids), category)
    make = partial(make_standard, tuple(models), category, noise, writer.file_of, writer)
    draw_missing(make, writer.file_of, len(models), views, seed, processes, progress)
    drawn = [view_seed(index, len(ids), seed) for index in range(views)]
    for chosen in SPLITS:
        if chosen in written or not layout.valid(chosen).exists():
            files = [writer.file_of(one).name for one in drawn if splits[ids[one[1]]] == chosen]
            write_text(layout.valid(chosen), "".join(f"{file}\n" for file in files))
    return layout


@dataclass(frozen=True)
class _ViewWriter:
    layout: Layout
    models: tuple[ObjectModel, ...]
    ids: tuple[str, ...]
    category: Category

    def file_of(self, seed: ViewSeed) -> Path:
        """The annotation."""
        return self.layout.annotation(f"{self.ids[seed[1]]}_{seed[2]:04d}.json")

    def __call__(self, view: View, annotation: Path) -> None:
        """Write depth, mask and, last, annotation."""
        _, index, _ = view.seed
        image = f"{annotation.stem}.png"
        stored = write_depth(self.layout.images / "depth" / image, view.depth, depth_step(self.category))
        mask = np.where(stored > 0, view.labels, np.uint8(0))
        write_png(self.layout.images / "category_mask" / image, np.repeat(mask[..., None], 3, 2))
        links = _links(self.models[index], view, self.category)
        instance = {"urdf_id": int(self.ids[index]), "bbox": _box(stored), "links": links}
        write_json(annotation, {**_size(view.camera), "depth_path": f"depth/{image}", "instances": [instance]})


def _size(camera: Camera) -> dict[str, int]:
    return {"width": camera.width, "height": camera.height}


def _split_of(name: str, category: Category, split: Split) -> Split:
    known = peculiarities(category).test_objects
    if not known or int(name) >= min(FIRST_ID.values()):
        return split
    return "test" if name in known else "train"


def _record_path(layout: Layout, split: Split) -> Path:
    """What a split was written with, so that nothing else is mixed into it."""
    return layout.folder / f"render_{split}.json"


def _links(model: ObjectModel, view: View, category: Category) -> list[dict[str, Any]]:
    """Pose of every part and state of every child, as annotations have them."""
    transforms = model.part_transforms(view.states, view.T_camera_base)
    transforms[:, :3, 3] /= category.metres_per_unit
    states = np.where(category.turning, -np.degrees(view.states), view.states / category.metres_per_unit).tolist()
    stated = [{}, *({"state": state} for state in states)]
    links = enumerate(zip(stated, transforms.tolist(), strict=True))
    return [{"link_category_id": part, **state, "transformation": T} for part, (state, T) in links]


def _box(stored: np.ndarray) -> list[int]:
    """x1, y1, x2, y2 around what is measured, half-open; of an empty image, all of it."""
    places = np.argwhere(stored if stored.any() else stored == 0)[:, ::-1]
    return [*places.min(0).tolist(), *(places.max(0) + 1).tolist()]


def _write_object(layout: Layout, name: str, model: ObjectModel, category: Category) -> None:
    """URDFs and points. Raises InputError where another object of this id is there already."""
    for path in (layout.aligned_urdf(name), layout.plain_urdf(name)):
        _write_same(path, _urdf(model, category))
    for part, mesh in enumerate(model.parts):
        rng = np.random.default_rng([int(name), part])
        corners = np.concatenate([mesh.vertices.argmin(0), mesh.vertices.argmax(0)])  # so that boxes are exact
        drawn = replace(model, parts=(mesh,)).surface_samples(POINTS - len(corners), rng).points
        points = np.concatenate([mesh.vertices[corners], drawn]) / category.metres_per_unit
        text = "".join(f"{x:.9f} {y:.9f} {z:.9f}\n" for x, y, z in points.tolist())
        _write_same(layout.points(name, part), text)


def _urdf(model: ObjectModel, category: Category) -> str:
    """Joints alone: a triple (x, y, z) is written "z x y", and limits in degrees or units."""
    robot, unit, add = ElementTree.Element("robot", name=model.name), category.metres_per_unit, ElementTree.SubElement
    for link in ("base", *map(str, range(len(model.parts)))):
        add(robot, "link", name=link)
    fixed = add(robot, "joint", name="joint_0", type="fixed")
    add(fixed, "origin", xyz="0 0 0", rpy="0 0 0")
    add(fixed, "parent", link="base")
    add(fixed, "child", link="0")
    for index, motion in enumerate(model.tree.motions):
        joint = add(robot, "joint", name=f"joint_{index + 1}", type=type_of(motion))
        add(joint, "origin", xyz=urdf_numbers(model.pivots[index, [2, 0, 1]] / unit))
        add(joint, "axis", xyz=urdf_numbers(model.axes[index, [2, 0, 1]]))
        add(joint, "parent", link="0")
        add(joint, "child", link=str(index + 1))
        limits = model.limits[index]
        low, high = (np.degrees(limits) if motion.turns else limits / unit).tolist()
        add(joint, "limit", lower=repr(low), upper=repr(high))
    return xml_text(robot)


def _write_rest_states(layout: Layout, category: Category) -> None:
    """The objects stand at rest as they are: those of every split that is there."""
    records = [read_json(path, AGAIN) for path in (_record_path(layout, split) for split in SPLITS) if path.exists()]
    ids = sorted(name for record in records for name in record["objects"])
    parts = [str(part) for part in range(1, len(category.parts))]
    write_json(layout.rest_states, {name: {part: {"state": 0.0} for part in parts} for name in ids})


def _write_same(path: Path, text: str) -> None:
    if path.exists() and path.read_text(encoding="utf-8") != text:
        raise InputError(f"{path}: already there, of another object; choose another folder or delete it")
    write_text(path, text)
