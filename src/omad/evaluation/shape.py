"""How near estimated surfaces are to the true ones: the numbers of ``omad eval shape``.

Surfaces are compared where they are seen, in the camera frame, so that errors of pose and joint states count. Lengths
are in category units, as in the papers' tables.
"""

from collections.abc import Iterable, Sequence
from dataclasses import asdict, astuple, dataclass
from typing import Any

import numpy as np

from omad.common.batches import batched, progress
from omad.data.rendering.standard_views import View, observe_all
from omad.estimation.estimate import Estimate
from omad.estimation.estimator import Estimator
from omad.geometry.closest import Surface
from omad.geometry.mesh import Mesh, closed, merge_meshes, sample_triangles
from omad.geometry.occupancy import occupancy
from omad.geometry.rigid import box
from omad.objects.model import ObjectModel

BATCH = 32
NEAR = 0.05
"""Category units: the F-score counts points this near to the other surface."""
SAMPLES = 5000
"""Points drawn from each surface, whose distances from the other are taken."""
SUPPORT = 20000
"""Samples by which the nearest triangles are found."""
CELLS = 100
"""Of the grid that volumes are compared on, along the longest side."""


@dataclass(frozen=True)
class SurfaceErrors:
    """Of one surface against the true one."""

    distance: float
    """Mean distance of either surface's points from the other, the mean of both ways."""
    f_score: float
    """Harmonic mean of the shares of either surface's points that are within ``NEAR`` of the other."""
    iou: float
    """Of the volumes; NaN where one of them is not closed."""


@dataclass(frozen=True)
class ShapeErrors:
    """Of one view's estimate."""

    whole: SurfaceErrors
    parts: tuple[SurfaceErrors, ...]


@dataclass(frozen=True)
class ShapeResult:
    """One view: what the estimate's surfaces are worth, and the hulls of its keypoints; None where the view could not
    be estimated."""

    object: str
    surface: ShapeErrors | None
    hull: ShapeErrors | None


def surface_errors(mesh: Mesh, truth: Mesh, seed: int = 0) -> SurfaceErrors:
    """Of a ``mesh`` against the true one, both in category units and in one frame."""
    precision, recall = surface_distances(mesh, truth, seed)
    near = [float((each <= NEAR).mean()) for each in (precision, recall)]
    f_score = 2 * near[0] * near[1] / max(sum(near), 1e-9)
    return SurfaceErrors(float(precision.mean() + recall.mean()) / 2, f_score, volume_iou(mesh, truth))


def surface_distances(mesh: Mesh, truth: Mesh, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Of points of a ``mesh`` (``SAMPLES``,) from the true one, and of the true one's from it; in one frame."""
    rng = np.random.default_rng(seed)
    drawn = [sample_triangles(each.triangles, SAMPLES, rng)[0] for each in (mesh, truth)]
    to_truth, to_mesh = (Surface.of(each.triangles, SUPPORT, rng) for each in (truth, mesh))
    return to_truth.distances(drawn[0]), to_mesh.distances(drawn[1])


def volume_iou(mesh: Mesh, truth: Mesh) -> float:
    """Intersection over union of two volumes, on a grid; NaN where one is not closed."""
    if not closed(mesh) or not closed(truth):
        return float("nan")
    low, high = box(np.concatenate([mesh.vertices, truth.vertices]))
    cell = float((high - low).max()) / CELLS
    shape = tuple(np.ceil((high - low) / cell).astype(int).tolist())
    a, b = (occupancy(each.triangles, low, cell, shape) for each in (mesh, truth))
    union = np.count_nonzero(a | b)
    return np.count_nonzero(a & b) / union if union else float("nan")


def shape_errors(parts: Sequence[Mesh], truth: Sequence[Mesh], unit: float) -> ShapeErrors:
    """Of posed part meshes against the true ones, all in metres and the camera frame."""
    mine, true = ([part.warped(lambda vertices: vertices / unit) for part in each] for each in (parts, truth))
    whole = surface_errors(merge_meshes(mine), merge_meshes(true))
    return ShapeErrors(whole, tuple(surface_errors(*pair) for pair in zip(mine, true, strict=True)))


def evaluate_shapes(
    estimator: Estimator, views: Iterable[View], models: Sequence[ObjectModel], total: int
) -> list[ShapeResult]:
    """Estimate every view and compare its surfaces with those of the object that was rendered."""
    results = []
    for some in batched(progress(views, total), BATCH):
        observed = observe_all(some)
        estimates = dict(zip(observed, estimator(list(observed.values())), strict=True))
        results += [_measure(view, models[view.seed[1]], estimates.get(index)) for index, view in enumerate(some)]
    return results


def _measure(view: View, model: ObjectModel, estimate: Estimate | None) -> ShapeResult:
    if estimate is None:
        return ShapeResult(view.object, None, None)
    truth, unit = model.posed(view.states, view.T_camera_base), estimate.category.metres_per_unit
    hulls = estimate.hull_model().posed(estimate.joint_states, estimate.T_camera_base)
    found = (shape_errors(parts, truth, unit) for parts in (estimate.surface.posed(), hulls))
    return ShapeResult(view.object, *found)


def shape_summary(results: Sequence[ShapeResult], part_names: Sequence[str]) -> dict[str, Any]:
    """Means and medians over the views that were estimated, as plain values."""
    answer: dict[str, Any] = {"views": len(results), "failures": sum(each.surface is None for each in results)}
    for kind in ("surface", "hull"):
        found = [errors for each in results if (errors := getattr(each, kind)) is not None]
        of_part = zip(*(errors.parts for errors in found), strict=True)
        answer[kind] = {"whole": _spread([errors.whole for errors in found])}
        answer[kind]["parts"] = {name: _spread(each) for name, each in zip(part_names, of_part, strict=False)}
    names = sorted({each.object for each in results})
    answer["by_object"] = [
        {"object": name} | _spread([r.surface.whole for r in results if r.object == name and r.surface])
        for name in names
    ]
    return answer


def _spread(errors: Sequence[SurfaceErrors]) -> dict[str, Any]:
    """Mean and median of every number, over those that have it; null where none has."""
    if not errors:
        return {}
    rows, names = np.array([astuple(each) for each in errors]), list(asdict(errors[0]))
    known = {name: column[~np.isnan(column)] for name, column in zip(names, rows.T, strict=True)}
    return {
        name: {"mean": float(column.mean()), "median": float(np.median(column))} if len(column) else None
        for name, column in known.items()
    }
