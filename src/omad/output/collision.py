"""Bodies for simulators: each part as several convex ones, hollow where the part is, and none touching another part's
in any state."""

from itertools import combinations, product

import numpy as np

from omad.geometry.convex import ConvexBody, convex_bodies, overlap
from omad.geometry.rigid import box
from omad.objects.model import ObjectModel

GAP = 0.002
"""Of the object's diagonal: what bodies of two parts keep between them."""
FLUSH = 0.008
"""Of the object's diagonal: details that stand out less are no bodies of their own."""
MOST = 40
"""Bodies a part."""
LOSS = 1 / 3
"""Of a part: what making room for a part that other joints move may cost; where it is more (temples of eyeglasses,
folded both at once, run into each other), room is made with all joints at rest only."""
SINGLE, DOUBLE = 61, 31
"""States of a joint that are tried: of a pair of parts that one joint moves, and of one that several move."""

Pair = tuple[list[ConvexBody], list[ConvexBody]]


def collision_bodies(model: ObjectModel) -> list[list[ConvexBody]]:
    """Of each part, canonical space at rest. Where bodies of two parts would overlap in some state of the joints within
    their limits, the one that loses less is cut back."""
    size = model.diagonal
    bodies = [convex_bodies(part, FLUSH * size)[:MOST] for part in model.parts]
    for first, second in combinations(range(len(bodies)), 2):
        pair, moving = (bodies[first], bodies[second]), _between(model, first, second)
        parted = _parted(pair, _relative(model, first, second, moving), GAP * size)
        if (
            len(moving) > 1
            and min(_volume(new) / _volume(old) for new, old in zip(parted, pair, strict=True)) < 1 - LOSS
        ):
            parted = _parted(pair, _relative(model, first, second, []), GAP * size)
        bodies[first], bodies[second] = parted
    return bodies


def _parted(pair: Pair, places: list[np.ndarray], gap: float) -> Pair:
    """Two parts' bodies that keep apart wherever the second part is, (4, 4) each, in the first one's frame."""
    parted = list(pair[0]), list(pair[1])
    for T in places:
        _part(*parted, T, gap)
    return parted


def _volume(bodies: list[ConvexBody]) -> float:
    return max(sum(body.volume for body in bodies), 1e-12)


def _between(model: ObjectModel, first: int, second: int) -> list[int]:
    """Joints that move one part against another."""
    return sorted(set(model.tree.path(first)) ^ set(model.tree.path(second)))


def _relative(model: ObjectModel, first: int, second: int, moving: list[int]) -> list[np.ndarray]:
    """(4, 4) from the second part's canonical coordinates to the first one's, over all states of the joints
    ``moving``."""
    steps = SINGLE if len(moving) == 1 else DOUBLE if len(moving) == 2 else 5
    found = []
    for chosen in product(*(np.linspace(low, high, steps) for low, high in model.limits[moving])):
        states = np.clip(0.0, *model.limits.T)
        states[moving] = chosen
        T = model.part_transforms(states)
        found.append(np.linalg.inv(T[first]) @ T[second])
    return found


def _part(first: list[ConvexBody], second: list[ConvexBody], T: np.ndarray, gap: float) -> None:
    """Cut bodies of two parts back where they overlap with the second part at T (4, 4) in the first one's frame."""
    moved = [body.carried(T) for body in second]
    boxes = [np.array([box(body.vertices) for body in bodies]).reshape(-1, 2, 3) for bodies in (first, moved)]
    if any(not len(each) for each in boxes):
        return
    near = (boxes[0][:, None, 0] < boxes[1][None, :, 1] + gap) & (boxes[1][None, :, 0] < boxes[0][:, None, 1] + gap)
    gone: tuple[set[int], set[int]] = set(), set()
    for i, j in np.argwhere(near.all(2)).tolist():
        if i in gone[0] or j in gone[1] or (found := overlap(first[i], moved[j], gap)) is None:
            continue
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
