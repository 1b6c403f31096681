"""Rest states that only the canonical frame tells: parts that reach where the spec says, as the arms of a lamp do."""

import math

import numpy as np

from omad.geometry.mesh import triangle_normals
from omad.geometry.rigid import split
from omad.objects.category import Category
from omad.objects.model import ObjectModel

from .rest_states import wrapped

PARALLEL = 0.99
"""Cosine from which the axis of a part's next joint runs as its own does: such a part reaches to that joint."""
SHORT = 0.01
"""Share of the object's diagonal below which a part reaches nowhere."""


def reaching_states(model: ObjectModel, category: Category) -> np.ndarray:
    """(J,) radians from the zero of a model in the canonical frame to where the parts reach as the spec says, each with
    those before it in place; 0 for joints whose rest is told otherwise. A limit is not heeded, but which of two whole
    turns counts."""
    states = np.zeros(len(category.joints))
    for joint, spec in enumerate(category.joints):
        if spec.rest != "reaching":
            continue
        placed = model.with_zero_at(states)
        axis = placed.axes[joint]
        own = split(_end(placed, category, joint) - placed.pivots[joint], axis)[1]
        wanted = split(np.array(spec.reach), axis)[1]
        if np.linalg.norm(own) > SHORT * model.diagonal:
            turn = math.atan2(np.cross(own, wanted) @ axis, own @ wanted)
            states[joint] = wrapped(turn, placed.limits[joint])
    return states


def _end(model: ObjectModel, category: Category, joint: int) -> np.ndarray:
    """(3,) where the part that a joint moves reaches to: its next hinge, or the middle of its surface, which turns with
    it as the middle of its box does not."""
    for after, spec in enumerate(category.joints):
        if spec.parent == joint + 1 and spec.motion.turns and abs(model.axes[after] @ model.axes[joint]) > PARALLEL:
            return model.pivots[after]
    triangles = model.parts[joint + 1].triangles
    areas = np.linalg.norm(triangle_normals(triangles), axis=1)
    return np.average(triangles.mean(1), axis=0, weights=areas + 1e-30)
