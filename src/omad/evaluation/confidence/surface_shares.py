"""How far answers should go towards the fits to their surfaces, and whether these should follow what is seen: measured
on views with known truth."""

from collections.abc import Iterator, Sequence

import numpy as np

from omad.common.batches import progress
from omad.common.errors import InputError
from omad.data.rendering.spoils.thinned import thinly_spoilt
from omad.data.rendering.standard_views import View, standard_view, true_pose
from omad.estimation.confidence.model import RIGHT_SHARE, right_within
from omad.estimation.estimate import Estimate
from omad.estimation.estimator import Estimator
from omad.geometry.mesh import merge_meshes
from omad.model.surfaces.bank import ShapeBank
from omad.model.surfaces.shares import Shares
from omad.model.surfaces.surfaces import FittedSurface, Surfaces
from omad.objects.category import Category
from omad.objects.model import ObjectModel

from ..metrics import pose_errors
from ..shape import surface_distances
from .views import APART

TRIED = np.array([0.0, 0.25, 0.5, 0.75, 1.0])
SURE = 1.64
"""Standard errors that are taken off a mean gain: in 95 of 100 cases what is gained is more than the rest."""
FEWEST = 10
"""Views with answers, of which a mean and its standard error say something."""


def measured_shares(estimator: Estimator, models: Sequence[ObjectModel], views: int, seed: int) -> Shares | None:
    """The shares that surely gain most on so many views of the ``models``, every second one spoilt. Errors count no
    more than those of the worst answer that is right. None where too few views are answered."""
    errors = []
    for view in progress(_views(models, estimator.category, views, seed), views, every=30.0):
        estimate = estimator(view.observation())
        if estimate.is_finite:
            errors.append(_errors(estimate, view))
    return best_shares(np.stack(errors)) if len(errors) >= FEWEST else None


def follows_better(estimator: Estimator, bank: ShapeBank, models: Sequence[ObjectModel], views: int, seed: int) -> bool:
    """Whether surfaces of the ``bank`` are surely nearer to the true ones when they follow what is seen, on such views
    of the ``models``."""
    prior, category = estimator.net.prior, estimator.category
    surfaces, gains = Surfaces(prior, category, lambda: bank), []
    for view in progress(_views(models, category, views, seed), views, every=30.0):
        estimate = estimator(view.observation())
        if estimate.is_finite:
            truth = merge_meshes(models[view.seed[1] % len(models)].posed(view.states, view.T_camera_base))
            seen = estimate.in_mirror() if estimate.of_other_hand else estimate
            given = seen, seen.covariance, seen.labelled.points, seen.part_labels
            both = surfaces.fitted_each(*given, follows=(False, True))
            if estimate.of_other_hand:
                both = [each.mirrored(category.turning) for each in both]
            posed = [merge_meshes(each.posed()) for each in both]
            still, followed = (sum(each.mean() for each in surface_distances(mesh, truth)) for mesh in posed)
            gains.append((still - followed) / (still + followed))
    return len(gains) >= FEWEST and bool(_surely(np.array(gains)) > 0)


def best_shares(errors: np.ndarray) -> Shares:
    """Those with the largest gain, of which chance is taken off, by errors (N, T, 1 + J) with the ``TRIED`` ones. A
    gain is the difference of two errors over their sum, so that no view counts more than another."""
    none, mean = errors[:, :1], errors.mean(0)
    gain = (none - errors) / np.maximum(none + errors, 1e-12)
    sure = _surely(gain)
    best = np.where(mean <= mean[0], sure, 0.0).argmax(0)  # the first where none is better: none
    return Shares(TRIED[best], np.stack([mean[0], mean[-1], mean[best, np.arange(len(best))]]), len(errors))


def _surely(gains: np.ndarray) -> np.ndarray:
    """Mean over the first axis of gains (N, ...), of which chance is taken off."""
    return gains.mean(0) - SURE * gains.std(0, ddof=1) / np.sqrt(len(gains))


def _errors(estimate: Estimate, view: View) -> np.ndarray:
    """(T, 1 + J) as ``Shares`` has them, with each of the ``TRIED`` shares of the whole step."""
    category = estimate.category
    seen = estimate.in_mirror() if estimate.of_other_hand else estimate
    surface, surfaces = seen.surface, seen.surfaces
    assert isinstance(surface, FittedSurface)
    assert surfaces is not None
    truth, boxes, diagonal = true_pose(view, category), view.truth.part_boxes, view.truth.diagonal
    most = np.append(RIGHT_SHARE * diagonal, right_within(category, diagonal))
    found = []
    for share in TRIED:
        placed = surfaces.towards(seen, surface, np.full(len(surface.step), share)).placed
        placed = placed.mirrored(category.turning) if estimate.of_other_hand else placed
        errors = pose_errors(placed, truth, boxes, category)
        ends = errors.translation[0] + errors.rotation[0] * diagonal / 2
        found.append(np.minimum(np.append(ends, errors.joint_state), most))
    return np.array(found) / np.append(category.metres_per_unit, category.state_units)


def _views(models: Sequence[ObjectModel], category: Category, count: int, seed: int) -> Iterator[View]:
    """Clean and spoilt by turns; those that show too little are left out."""
    for index in range(count):
        model, drawn = models[index % len(models)], (seed, index, APART)
        try:
            view = standard_view(model, category, drawn) if index % 2 == 0 else thinly_spoilt(model, category, drawn)
            if view is not None:
                view.observation()
        except InputError:
            continue
        if view is not None:
            yield view
