"""Standard views in shards, as ``omad render --cluster`` writes them: rows that ``omad bulk`` takes as they are.

Columns: ``id`` (object/number), ``depth`` and ``labels`` (PNG), ``depth_scale`` (metres per stored number),
``intrinsics`` (fx, fy, cx, cy), ``object``, ``seed``, ``states`` (J) and ``T_camera_base`` (4 x 4, row by row); of the
object ``axes``, ``pivots``, ``limits`` and ``part_boxes`` (row by row), and ``of_other_hand``: true of one that was
imported as its mirror image. With clutter also ``mask`` and ``instances`` (PNG), and ``spoil`` (JSON).
"""

import io
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from PIL import Image

from omad.common.decode import Shape, Within, decode, within
from omad.common.errors import InputError
from omad.common.incoming import address_of, decoded, is_file, parse_json, read_image, readable
from omad.geometry.camera import Camera
from omad.objects.category import Category
from omad.objects.model import ObjectModel, digest_of_models
from omad.sensing.depth_files import parse_depth

from ..rendering.standard_views import ObjectTruth, View
from ..rendering.stored_images import as_stored, where_stored
from ..rendering.view_records import ViewRecord
from .parquet import RUN, import_pyarrow, part_name
from .store import Store

FORMAT = "omad-view-shards-1"
CURE = "give a folder or an address that omad render --cluster made"
IMAGES = ("depth", "labels")
NUMBERS = ("states", "T_camera_base", "axes", "pivots", "limits", "part_boxes")
READ = ("object", "seed", "depth_scale", "intrinsics", *IMAGES, *NUMBERS)
"""Columns that a view is made of ..."""
OPTIONAL = ("mask", "of_other_hand")
"""... and those that not all have."""
SCALE = Annotated[float, Within(1e-9, 1e3)]
ROWS = 16
"""Read together."""


@dataclass(frozen=True)
class _Run:
    """What of ``_run.json`` tells of views."""

    format: str
    category: str
    noise: str
    clutter: bool
    total: Annotated[int, Within(1, 1e12)]
    shard: Annotated[int, Within(1, 1e9)]


def run_record(category: Category, models: Sequence[ObjectModel]) -> dict[str, Any]:
    """What tells that a run makes views of the category, and of which objects."""
    return {"format": FORMAT, "category": category.name, "spec": asdict(category), "models": digest_of_models(models)}


def view_schema(clutter: bool) -> Any:
    """pyarrow.Schema of the rows."""
    pyarrow = import_pyarrow()
    text, image, number = pyarrow.string(), pyarrow.binary(), pyarrow.float64()
    columns = {"id": text, **dict.fromkeys(IMAGES, image), "depth_scale": number, "object": text}
    columns |= {"seed": pyarrow.list_(pyarrow.int64()), "of_other_hand": pyarrow.bool_()}
    columns |= dict.fromkeys(("intrinsics", *NUMBERS), pyarrow.list_(number))
    if clutter:
        columns |= {"mask": image, "instances": image, "spoil": text}
    return pyarrow.schema(columns)


def row_of(view: View, depth_scale: float) -> dict[str, Any]:
    """A view as a row."""
    truth, camera = view.truth, view.camera
    numbers = {name: getattr(view if name in ("states", "T_camera_base") else truth, name) for name in NUMBERS}
    row = {
        "id": f"{truth.name}/{view.seed[2]:05d}",
        "depth": as_png(as_stored(view.depth, depth_scale)),
        "labels": as_png(where_stored(view.labels, view.depth, depth_scale)),
        "depth_scale": depth_scale,
        "intrinsics": [camera.fx, camera.fy, camera.cx, camera.cy],
        "object": truth.name,
        "seed": list(view.seed),
        "of_other_hand": truth.of_other_hand,
        **{name: values.ravel().tolist() for name, values in numbers.items()},
    }
    return row if view.mask is None else row | {"mask": as_png(view.mask.astype(np.uint8) * 255)}


def as_png(image: np.ndarray) -> bytes:
    """8 or 16 bit."""
    file = io.BytesIO()
    Image.fromarray(image).save(file, "PNG", compress_level=1)
    return file.getvalue()


@dataclass(frozen=True)
class ViewShards:
    """Views in shards, in the order they were drawn."""

    store: Store
    category: Category
    noisy: bool
    """Whether a camera's noise was simulated."""
    total: int
    size: int
    """Of a shard; the last one may be smaller."""
    run: str
    """What ``_run.json`` says."""

    def __len__(self) -> int:
        return self.total

    def after(self, skip: int) -> Iterator[View]:
        """Without the first so many, whose shards are not opened. Raises InputError for a file that was changed."""
        for number in range(skip // self.size, -(-self.total // self.size)):
            yield from self._read(number, max(skip - number * self.size, 0))

    def _read(self, number: int, skip: int) -> Iterator[View]:
        name, rows = part_name(number), min(self.size, self.total - number * self.size)
        place = f"{self.store.place}/{name}"
        with readable(place, "views in shards", CURE), self.store.open(name) as stored:
            file = import_pyarrow().parquet.ParquetFile(stored)
            there = file.schema_arrow.names
            if missing := [column for column in READ if column not in there]:
                raise InputError(f"{place}: no column {missing[0]}; render it again with this version")
            if file.metadata.num_rows != rows:
                raise InputError(f"{place}: {file.metadata.num_rows} views in place of {rows}; delete it, render again")
            columns = [*READ, *(column for column in OPTIONAL if column in there)]
            start = 0
            for batch in file.iter_batches(ROWS, columns=columns):
                for row, values in enumerate(batch.to_pylist(), start):
                    if row >= skip:
                        yield self._view(values, f"{place}[{row}]")
                start += batch.num_rows

    def _view(self, row: dict[str, Any], place: str) -> View:
        joints = len(self.category.joints)
        shapes = {"axes": (joints, 3), "pivots": (joints, 3), "limits": (joints, 2), "part_boxes": (joints + 1, 2, 3)}
        shapes |= {"states": (joints,), "T_camera_base": (4, 4), "intrinsics": (4,)}
        with readable(place, "a view", CURE):
            found = {}
            for name, shape in shapes.items():
                with within(name):
                    found[name] = Shape(*shape).array(np.reshape(row[name], shape))
            with within("depth_scale"):
                scale = decode(SCALE, row["depth_scale"])
            depth = parse_depth(row["depth"], f"{place}: depth", scale)
            labels = read_image(row["labels"], f"{place}: labels")
            mask = None if row.get("mask") is None else read_image(row["mask"], f"{place}: mask") > 0
            if any(image is not None and image.shape != depth.shape for image in (labels, mask)):
                raise ValueError("depth, labels and mask are of different sizes")
            camera = Camera(depth.shape[1], depth.shape[0], *found.pop("intrinsics").tolist())
            pose, seed = ViewRecord(found.pop("states"), found.pop("T_camera_base"), camera=camera), tuple(row["seed"])
            truth = ObjectTruth(name=str(row["object"]), **found, of_other_hand=bool(row.get("of_other_hand")))
        return View(truth, depth, labels, camera, pose.states, pose.T_camera_base, seed, mask)


def is_view_shards(source: str) -> bool:
    """Whether shards lie here: in a folder, or at any address."""
    return address_of(source) is not None or is_file(Path(source) / RUN)


def open_view_shards(source: str, category: Category) -> ViewShards:
    """What ``omad render --cluster`` wrote into a folder, or at an address that fsspec knows. Raises InputError where
    there is none, it is of another category, or not finished."""
    store = Store.of(source)
    with readable(source, "views in shards", CURE):
        names = store.names()
        if RUN not in names:
            raise InputError(f"{source}: no {RUN} there; {CURE}")
        said = store.read(RUN)
        values = parse_json(said, f"{source}/{RUN}", CURE)
    if not isinstance(values, dict) or values.get("format") != FORMAT:
        raise InputError(f"{source}: holds no views with their truth in shards ({RUN} tells of none); {CURE}")
    run = decoded(_Run, values, f"{source}/{RUN}", CURE)
    if run.category != category.name:
        raise InputError(f"{source}: views of {run.category}, not of {category.name}")
    shards = -(-run.total // run.shard)
    if shards > len(names) or not names.issuperset(map(part_name, range(shards))):
        cure = "give the same render command again to finish it"
        raise InputError(f"{source}: not all of its {shards} shards are there; {cure}")
    return ViewShards(store, category, run.clutter or run.noise != "off", run.total, run.shard, str(said))
