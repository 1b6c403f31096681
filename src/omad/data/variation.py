"""Many objects of few: models of one's own with other proportions, with parts of each other, and mirrored.

An object with its parts at rest is bent along each canonical axis by a growing, piecewise straight function, so that
what lies side by side gets other shares of the whole: a door and the panel beside it, a drawer and the wall around it.
Planes and edges along the axes stay planes and edges, parts that touch go on touching, and joints go along.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from omad.geometry.rigid import box
from omad.geometry.transforms import MIRROR_X
from omad.objects.category import Category
from omad.objects.model import ObjectModel, SampledObject
from omad.objects.pose import mirrored_axes

APART = 0.02
"""Bends are at least so far apart, as a share of the object's extent."""
SIMILAR = 2.5
"""A part takes another's place where none of its sides is so many times as long or as short."""

AT_REST = 0.07
"""Share of their ranges within which the joints of an object are that is nearly at rest."""


@dataclass(frozen=True)
class Variation:
    """How much models are varied; spreads are of the logarithm of a length."""

    whole: float = 0.12
    """Spread of the object's extent along each axis."""
    shares: float = 0.3
    """Spread of the lengths between two bends."""
    bends: int = 2
    """Along each axis, beyond those at the ends of parts."""
    exchanged: float = 0.4
    """Share of parts that come from another model."""


def with_variants(
    models: Sequence[SampledObject], category: Category, count: int, seed: int = 0, how: Variation = Variation()
) -> list[SampledObject]:
    """The ``models`` and variants of one after the other, ``count`` objects in all; metres, canonical space. Those
    without meshes stay as they are."""
    whole = [model for model in models if isinstance(model, ObjectModel)]
    made = list(models)
    for index in range(len(made), count if whole else 0):
        rng = np.random.default_rng([seed, index])
        model = _with_parts_of_others(whole[index % len(whole)], whole, how.exchanged, rng)
        if rng.random() < 0.5 and category.part_images is not None:
            model = mirrored(model, category)
        made.append(replace(_bent(model, category, how, rng), name=f"{model.name}-{index}"))
    return made


def nearly_at_rest(model: ObjectModel, rng: np.random.Generator) -> ObjectModel:
    """An object whose joints move no farther than a little, as one that is shut or all but shut."""
    return replace(model, limits=AT_REST * rng.random() * model.limits)


def mirrored(model: ObjectModel, category: Category) -> ObjectModel:
    """The image in the plane x = 0 of an object whose parts are all mirrored onto each other or themselves."""
    image = [part.mirror for part in category.parts if part.mirror is not None]
    joints = np.array(image[1:]) - 1
    axes = mirrored_axes(model.axes[joints], category.turning)
    back = (axes * category.axes).sum(1) < 0
    limits = np.where(back[:, None], -model.limits[joints, ::-1], model.limits[joints])
    parts = tuple(model.parts[of].mirrored() for of in image)
    axes, pivots = np.where(back[:, None], -axes, axes), model.pivots[joints] * MIRROR_X
    return replace(model, parts=parts, axes=axes, pivots=pivots, limits=limits)


def _with_parts_of_others(
    model: ObjectModel, models: Sequence[ObjectModel], share: float, rng: np.random.Generator
) -> ObjectModel:
    """Some parts as other models have them, fitted into the box of the own one, whose joint stays."""
    parts, boxes = list(model.parts), model.part_boxes()
    for k, own in enumerate(boxes):
        donor = models[int(rng.integers(len(models)))].parts[k]
        theirs = box(donor.vertices)
        size, factors = np.maximum(np.ptp(theirs, axis=0), 1e-9), np.ptp(own, axis=0)
        factors = factors / size
        if rng.random() < share and np.all((factors < SIMILAR) & (factors > 1 / SIMILAR)):
            parts[k] = donor.warped(lambda vertices: own[0] + (vertices - theirs[0]) * factors)  # noqa: B023 (at once)
    return replace(model, parts=tuple(parts))


def _bent(model: ObjectModel, category: Category, how: Variation, rng: np.random.Generator) -> ObjectModel:
    """Other proportions; where the category has mirror images, left and right alike."""
    boxes = model.part_boxes()
    alike = any(part.mirror is not None for part in category.parts)
    bends = [_Bend.drawn(boxes[:, :, c], how, alike and c == 0, rng) for c in range(3)]

    def move(points: np.ndarray) -> np.ndarray:
        return np.stack([bend(points[:, c]) for c, bend in enumerate(bends)], 1)

    turning = np.array(category.turning)[:, None]
    middles, reach = boxes[1:].mean(1), np.linalg.norm(np.ptp(boxes[1:], axis=1), axis=1, keepdims=True) / 2
    at = np.where(turning, model.pivots, middles)
    lines = move(at + reach * model.axes) - move(at - reach * model.axes)
    length = np.linalg.norm(lines, axis=1, keepdims=True)
    limits = np.where(turning, model.limits, model.limits * length / (2 * reach))
    parts = tuple(part.warped(move) for part in model.parts)
    return replace(model, parts=parts, axes=lines / length, pivots=move(at), limits=limits).centred()


@dataclass(frozen=True)
class _Bend:
    """A growing, piecewise straight function of one coordinate, straight on beyond its ends."""

    before: np.ndarray
    """(n,) growing."""
    after: np.ndarray
    """(n,) growing."""

    @classmethod
    def drawn(cls, ends: np.ndarray, how: Variation, odd: bool, rng: np.random.Generator) -> Self:
        """With bends at the ``ends`` of parts (K, 2) and between; ``odd``: of the same shape to either side of 0."""
        low, high = ends.min(), ends.max()
        if low == high:  # a sheet has nothing to bend across it
            return cls(np.array([low, low + 1]), np.array([low, low + 1]))
        inner = rng.uniform(low, high, how.bends)
        places = np.concatenate([[low, high], np.where(rng.random(ends.size) < 0.8, ends.ravel(), low), inner])
        if odd:
            places = np.append(np.abs(places - (low + high) / 2), 0.0)
        kept = _apart(np.sort(places), APART * (high - low))
        lengths = np.diff(kept)
        longer = lengths * np.exp(np.clip(rng.normal(0.0, how.shares, len(lengths)), -0.7, 0.7))
        longer *= lengths.sum() / longer.sum() * np.exp(rng.normal(0.0, how.whole))
        after = np.concatenate([[0.0], longer.cumsum()])
        if not odd:
            return cls(kept, after)
        middle = (low + high) / 2
        return cls(middle + np.concatenate([-kept[:0:-1], kept]), middle + np.concatenate([-after[:0:-1], after]))

    def __call__(self, values: np.ndarray) -> np.ndarray:
        slopes = np.diff(self.after) / np.diff(self.before)
        index = np.clip(np.searchsorted(self.before, values) - 1, 0, len(slopes) - 1)
        return self.after[index] + (values - self.before[index]) * slopes[index]


def _apart(places: np.ndarray, least: float) -> np.ndarray:
    """Sorted places (n,) without those that come less than ``least`` after the one before; the last one stays."""
    kept = [places[0]]
    for place in places[1:-1]:
        if place - kept[-1] >= least and places[-1] - place >= least:
            kept.append(place)
    return np.array([*kept, places[-1]])
