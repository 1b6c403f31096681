"""``omad eval pose --cluster``: views in shards, and one summary of all of them."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields
from functools import cache
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from omad.common.batches import batched
from omad.data.rendering.depth_noise import LEVELS
from omad.data.rendering.standard_views import View, standard_views
from omad.data.shards.parquet import import_pyarrow
from omad.data.source import Broken, kind_of, load_models, load_views
from omad.estimation.estimator import Estimator, EstimatorConfig
from omad.objects.category import Category
from omad.objects.model import ObjectModel

from .evaluate import BATCH, Measured, measure
from .metrics import PoseErrors

STEPS = ("network", "refinement", "surface")
"""Of an answer, whose seconds are kept where they were taken."""


@dataclass(frozen=True)
class PoseWork:
    """Errors on the views of ``omad eval pose``."""

    weights: str | Path
    device: str
    fast: bool
    to_surface: bool
    source: str
    objects: int
    views: int
    seed: int
    noise: str
    broken: Broken

    def __call__(self, start: int, stop: int) -> list[dict[str, Any]]:
        """Rows of the views from ``start`` to before ``stop``."""
        estimator = _loaded(self)
        some = batched(islice(self._views(estimator.category, start), stop - start), BATCH)
        return [_row(result.measured) for views in some for result in measure(estimator, views, self.to_surface)]

    def _views(self, category: Category, start: int) -> Iterable[View]:
        """As of ``load_views``, from ``start`` on; models are made once for all shards."""
        if kind_of(self.source).images is None:
            return standard_views(_models(self), category, self.views, self.seed, LEVELS[self.noise], start)
        drawn = (self.objects, self.views, self.seed, self.noise)
        return load_views(self.source, category, *drawn, self.broken, start).views

    def schema(self) -> Any:
        """pyarrow.Schema of the rows."""
        pyarrow = import_pyarrow()
        number = pyarrow.float64()
        kinds = {f.name: pyarrow.list_(number) if f.type is np.ndarray else pyarrow.bool_() for f in fields(PoseErrors)}
        errors = pyarrow.struct(kinds)
        seconds = pyarrow.struct(dict.fromkeys(STEPS, number))
        columns = {"object": pyarrow.string(), "diagonal": number, "seconds": seconds}
        return pyarrow.schema(columns | {"initial": errors, "refined": errors})

    def refused(self, row: dict[str, Any]) -> bool:
        """Whether the view could not be estimated."""
        return row["refined"]["missing"]


def from_rows(rows: Iterable[dict[str, Any]]) -> Iterator[Measured]:
    """What was measured, of rows as they are read back."""
    for row in rows:
        seconds = row["seconds"] and {step: time for step, time in row["seconds"].items() if time is not None}
        errors = {name: _errors(row[name]) for name in ("initial", "refined")}
        yield Measured(**{**row, "seconds": seconds, **errors})


@cache
def _loaded(work: PoseWork) -> Estimator:
    """Once a process."""
    return Estimator.from_pretrained(work.weights, work.device, EstimatorConfig.fast() if work.fast else None)


@cache
def _models(work: PoseWork) -> Sequence[ObjectModel]:
    """Once a process."""
    category = _loaded(work).category
    return load_models(work.source, category, min(work.objects, work.views), "test", work.seed).models


def _row(one: Measured) -> dict[str, Any]:
    seconds = None if one.seconds is None else {name: one.seconds.get(name) for name in STEPS}
    errors = {"initial": _plain(one.initial), "refined": _plain(one.refined)}
    return {"object": one.object, "diagonal": one.diagonal, "seconds": seconds, **errors}


def _plain(errors: PoseErrors) -> dict[str, Any]:
    return {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in vars(errors).items()}


def _errors(row: dict[str, Any]) -> PoseErrors:
    found: dict[str, Any] = {k: np.array(v, dtype=float) if isinstance(v, list) else v for k, v in row.items()}
    return PoseErrors(**found)
