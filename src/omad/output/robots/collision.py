"""Bodies for simulators: each part as several convex ones, hollow where the part is, and none touching another part's
in any state."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import combinations
from typing import Self

import numpy as np
import torch

from omad.geometry.convex.bodies import ConvexBody, convex_bodies, overlap
from omad.geometry.kinematics import part_transforms
from omad.geometry.rigid import box, carry
from omad.objects.model import ObjectModel

GAP = 0.002
"""Of the object's diagonal: what bodies of two parts keep between them."""
FLUSH = 0.008
"""Of the object's diagonal: details that stand out less are no bodies of their own."""
MOST = 80
"""Bodies a part."""
SLICES = 12
"""Of a part whose bodies are cut locally, along its longest side."""
SLIVER = 1e-6
"""Of a part's box: pieces that are smaller are left out; simulators refuse bodies next to without volume."""
PARALLEL = 0.99
"""Cosine between axes from which on they count as parallel."""
SINGLE, DOUBLE = 241, 61
"""States of a joint that are tried: of a pair of parts that one joint moves, and of one that several move."""


def collision_bodies(model: ObjectModel) -> list[list[ConvexBody]]:
    """Of each part, canonical space at rest. Where bodies of two parts would overlap in some state of the joints within
    their limits, the one that loses less is cut back; where several joints turn both about one direction (temples of
    eyeglasses), one keeps what is above and the other what is below."""
    size = model.diagonal
    bodies = [convex_bodies(part, FLUSH * size)[:MOST] for part in model.parts]
    for first, second in combinations(range(len(bodies)), 2):
        moving = _between(model, first, second)
        places, direction = relative_places(model, first, second), _common_axis(model, moving)
        places = _meeting(bodies[first], bodies[second], places, GAP * size)
        if direction is not None:
            for side in (first, second):
                bodies[side] = _sliced(bodies[side])
            make_room = partial(_stack, direction=direction)
            _clear(bodies[first], bodies[second], places, GAP * size, make_room)
        _clear(bodies[first], bodies[second], places, GAP * size, _part)
    return [_without_slivers(each) for each in bodies]


def _common_axis(model: ObjectModel, moving: list[int]) -> np.ndarray | None:
    """(3,) the direction that several joints turn about, if they do and it is one."""
    axes = model.axes[moving]
    if len(moving) < 2 or not all(model.tree.turning[joint] for joint in moving):
        return None
    return axes[0] if (np.abs(axes @ axes[0]) > PARALLEL).all() else None


def _between(model: ObjectModel, first: int, second: int) -> list[int]:
    """Joints that move one part against another."""
    return sorted(set(model.tree.path(first)) ^ set(model.tree.path(second)))


def relative_places(model: ObjectModel, first: int, second: int) -> np.ndarray:
    """(S, 4, 4) from the second part's canonical coordinates to the first one's, over all possible states of the joints
    between the two."""
    moving = _between(model, first, second)
    steps = SINGLE if len(moving) == 1 else DOUBLE if len(moving) == 2 else 5
    each = (np.linspace(low, high, steps) for low, high in model.limits[moving])
    tried = np.stack(np.meshgrid(*each, indexing="ij"), -1)
    states = np.repeat(np.clip(0.0, *model.limits.T)[None], tried[..., 0].size, 0)
    states[:, moving] = tried.reshape(len(states), -1)
    states = states[model.possible(states, moving)]
    fixed = (np.repeat(each[None], len(states), 0) for each in (model.axes, model.pivots, np.eye(4)))
    axes, pivots, base = map(torch.as_tensor, fixed)
    T = part_transforms(model.tree, axes, pivots, torch.as_tensor(states), base).numpy()
    return np.linalg.inv(T[:, first]) @ T[:, second]


def _meeting(first: list[ConvexBody], second: list[ConvexBody], places: np.ndarray, gap: float) -> np.ndarray:
    """Those of the second part's places (S, 4, 4) at which bodies may come nearer than ``gap``, by the spheres around
    their boxes."""
    if not first or not second:
        return places[:0]
    boxes = (np.array([body.box for body in bodies]) for bodies in (first, second))
    spheres = [(each.mean(1), np.linalg.norm(each[:, 1] - each[:, 0], axis=1) / 2) for each in boxes]
    (one, of_one), (other, of_other) = spheres
    moved = np.einsum("sij,bj->sbi", places[:, :3, :3], other) + places[:, None, :3, 3]
    apart = np.linalg.norm(one[None, :, None] - moved[:, None], axis=3) - of_one[:, None] - of_other
    return places[(apart < gap).any((1, 2))]


def _sliced(bodies: list[ConvexBody]) -> list[ConvexBody]:
    """Bodies of one part cut across the part's longest side, so that what makes room is no more than needs to."""
    low, high = box(np.concatenate([body.vertices for body in bodies])) if bodies else np.zeros((2, 3))
    along = np.eye(3)[(high - low).argmax()]
    ends = np.linspace(low @ along, high @ along, SLICES + 1)
    slices = [
        piece
        for body in bodies
        for start, end in zip(ends, ends[1:], strict=False)
        if (upper := body.cut(along, start)) is not None and (piece := upper.cut(-along, -end)) is not None
    ]
    return _without_slivers(slices)


def _without_slivers(bodies: list[ConvexBody]) -> list[ConvexBody]:
    """Those of one part that are no cuts' left-overs."""
    low, high = box(np.concatenate([body.vertices for body in bodies])) if bodies else np.zeros((2, 3))
    return [body for body in bodies if body.volume > SLIVER * float(np.prod(high - low))]


def _clear(
    first: list[ConvexBody], second: list[ConvexBody], places: np.ndarray, gap: float, make_room: Callable[..., bool]
) -> None:
    """Let ``make_room`` cut bodies of two parts back at each of the second part's places (S, 4, 4) in the first one's
    frame. It is given the pairs whose boxes come nearer than ``gap``, and tells whether it cut anything."""
    one, other = _Boxes.of(first), _Boxes.of(second)
    for T in places:
        low, high = other.at(T)
        apart = (one.low[:, None] >= high + gap) | (low >= one.high[:, None] + gap)
        pairs = np.argwhere(~apart.any(2)).tolist()
        if pairs and make_room(first, second, T, gap, pairs):
            one, other = _Boxes.of(first), _Boxes.of(second)


@dataclass(frozen=True)
class _Boxes:
    """The boxes of one part's B bodies."""

    points: np.ndarray
    """(V, 3) vertices of all bodies."""
    starts: np.ndarray
    """(B,) where each one's begin."""
    low: np.ndarray
    """(B, 3)."""
    high: np.ndarray
    """(B, 3)."""

    @classmethod
    def of(cls, bodies: list[ConvexBody]) -> Self:
        counts = [len(body.vertices) for body in bodies]
        points = np.concatenate([np.zeros((0, 3)), *(body.vertices for body in bodies)])
        starts = np.cumsum([0, *counts[:-1]])[: len(bodies)]
        return cls(points, starts, *_ends(points, starts))

    def at(self, T: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Low and high corners (B, 3) of the boxes of the bodies moved by T (4, 4)."""
        return _ends(carry(T, self.points), self.starts)


def _ends(points: np.ndarray, starts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    if not len(starts):
        return np.zeros((0, 3)), np.zeros((0, 3))
    return np.minimum.reduceat(points, starts), np.maximum.reduceat(points, starts)


def _stack(
    first: list[ConvexBody], second: list[ConvexBody], T: np.ndarray, gap: float, pairs: list[list[int]],
    direction: np.ndarray,
) -> bool:  # fmt: skip
    """Where bodies of two parts overlap with the second part at T (4, 4) in the first one's frame, leave those of the
    first what is below the middle of both along ``direction`` (3,), and those of the second what is above."""
    moved = {j: second[j].carried(T) for j in {j for _, j in pairs}}
    back, cut = np.linalg.inv(T), False
    for i, j in pairs:
        if overlap(first[i], moved[j], gap) is None:
            continue
        heights = first[i].vertices @ direction, moved[j].vertices @ direction
        middle = (max(h.min() for h in heights) + min(h.max() for h in heights)) / 2
        below, above = first[i].cut(-direction, gap / 2 - middle), moved[j].cut(direction, middle + gap / 2)
        if below is not None and above is not None:
            first[i], moved[j], second[j], cut = below, above, above.carried(back), True
    return cut


def _part(first: list[ConvexBody], second: list[ConvexBody], T: np.ndarray, gap: float, pairs: list[list[int]]) -> bool:
    """Cut bodies of two parts back where they overlap with the second part at T (4, 4) in the first one's frame."""
    moved = {j: second[j].carried(T) for j in {j for _, j in pairs}}
    gone: tuple[set[int], set[int]] = set(), set()
    cut = False
    for i, j in pairs:
        if i in gone[0] or j in gone[1] or (found := overlap(first[i], moved[j], gap)) is None:
            continue
        cut = True
        if found.cut_second:
            left = moved[j].cut(found.normal, found.first_end + gap)
            if left is None:
                gone[1].add(j)
            else:
                moved[j], second[j] = left, left.carried(np.linalg.inv(T))
        else:
            left = first[i].cut(-found.normal, gap - found.second_start)
            if left is None:
                gone[0].add(i)
            else:
                first[i] = left
    for bodies, lost in zip((first, second), gone, strict=True):
        bodies[:] = [body for index, body in enumerate(bodies) if index not in lost]
    return cut
