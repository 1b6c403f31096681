"""``omad render --cluster``: views with their truth as rows, which ``omad bulk`` takes as they are.

Columns: ``id`` (object/number), ``depth`` and ``labels`` (PNG), ``depth_scale`` (metres per stored number),
``intrinsics`` (fx, fy, cx, cy), ``object``, ``seed``, ``states`` (J) and ``T_camera_base`` (4 x 4, row by row); of the
object ``axes``, ``pivots``, ``limits`` (row by row). With clutter also ``mask`` and ``instances`` (PNG), and ``spoil``
(JSON).
"""

import io
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cache
from typing import Any

import numpy as np
from PIL import Image

from omad.data.rendering.depth_noise import LEVELS
from omad.data.rendering.spoils.spoiling import cluttered
from omad.data.rendering.standard_views import View, standard_view, view_seed
from omad.data.rendering.view_folder import as_stored, depth_scale_of
from omad.data.source import Split, load_models
from omad.objects.category import Category
from omad.objects.category_file import get_category
from omad.objects.model import ObjectModel

from ..bulk.parquet_images import import_pyarrow


@dataclass(frozen=True)
class RenderWork:
    """Standard views, dealt out to the objects in turn, or with ``clutter`` scenes spoilt at random."""

    category: str
    source: str
    objects: int
    split: Split
    seed: int
    noise: str
    """One of ``depth_noise.LEVELS``."""
    clutter: bool

    def __call__(self, start: int, stop: int) -> list[dict[str, Any]]:
        """Rows of the views from ``start`` to before ``stop``."""
        category, models = _loaded(self)
        scale = depth_scale_of(category)
        rows = []
        for index in range(start, stop):
            seed = view_seed(index, len(models), self.seed)
            model, more = models[seed[1]], {}
            if self.clutter:
                spoil, made = cluttered(model, category, seed)
                view, more = made.view, {"instances": _png(made.instances), "spoil": json.dumps(asdict(spoil))}
                if view.mask is not None:
                    more["mask"] = _png(view.mask.astype(np.uint8) * 255)
            else:
                view = standard_view(model, category, seed, LEVELS[self.noise])
            rows.append(_row(view, scale) | more)
        return rows

    def schema(self) -> Any:
        """pyarrow.Schema of the rows."""
        pyarrow = import_pyarrow()
        text, image, number = pyarrow.string(), pyarrow.binary(), pyarrow.float64()
        columns = {"id": text, "depth": image, "labels": image, "depth_scale": number, "object": text}
        columns |= {"seed": pyarrow.list_(pyarrow.int64())}
        lists = ("intrinsics", "states", "T_camera_base", "axes", "pivots", "limits")
        columns |= dict.fromkeys(lists, pyarrow.list_(number))
        if self.clutter:
            columns |= {"mask": image, "instances": image, "spoil": text}
        return pyarrow.schema(columns)

    def refused(self, row: dict[str, Any]) -> bool:
        """No view is: an object that cannot be seen ends the run."""
        return False


@cache
def _loaded(work: RenderWork) -> tuple[Category, Sequence[ObjectModel]]:
    """Once a process."""
    category = get_category(work.category)
    return category, load_models(work.source, category, work.objects, work.split, work.seed).models


def _row(view: View, scale: float) -> dict[str, Any]:
    truth, camera = view.truth, view.camera
    numbers = {"states": view.states, "T_camera_base": view.T_camera_base}
    numbers |= {"axes": truth.axes, "pivots": truth.pivots, "limits": truth.limits}
    return {
        "id": f"{truth.name}/{view.seed[2]:05d}",
        "depth": _png(as_stored(view.depth, scale)),
        "labels": _png(view.labels),
        "depth_scale": scale,
        "intrinsics": [camera.fx, camera.fy, camera.cx, camera.cy],
        "object": truth.name,
        "seed": list(view.seed),
        **{name: values.ravel().tolist() for name, values in numbers.items()},
    }


def _png(image: np.ndarray) -> bytes:
    file = io.BytesIO()
    Image.fromarray(image).save(file, "PNG", compress_level=1)
    return file.getvalue()
