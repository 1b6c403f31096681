"""Things to put beside an object or before it: boxes, cans and procedural objects of other categories."""

import numpy as np
from scipy.spatial.transform import Rotation

from omad.data.procedural import GENERATORS, generate
from omad.data.procedural.shapes import box, cylinder
from omad.geometry.mesh import Mesh, merge_meshes
from omad.geometry.rigid import box as bounds
from omad.geometry.rigid import diagonal as diagonal_of
from omad.geometry.rigid import rigid
from omad.objects.category_file import get_category

from ..viewpoints import random_states

PROCEDURAL = 0.5
"""Share of the things that are objects of a category."""


def random_thing(diagonal: float, rng: np.random.Generator, category: str = "") -> Mesh:
    """A thing whose box has ``diagonal`` (metres), turned about y at random, its foot at y = 0 and its middle on the y
    axis. It is of another category than the one named."""
    mesh = _procedural(rng, category) if rng.random() < PROCEDURAL else simple_thing(rng)
    thing = standing(mesh, rng.uniform(0, 2 * np.pi), 1.0)
    size = diagonal / diagonal_of(thing.vertices)
    return thing.warped(lambda vertices: vertices * size)


def standing(mesh: Mesh, turn: float, scale: float) -> Mesh:
    """Turned about y and scaled, its foot at y = 0 and its middle on the y axis."""
    mesh = mesh.carried(rigid(Rotation.from_rotvec([0, turn, 0]).as_matrix(), np.zeros(3)))
    low, high = bounds(mesh.vertices)
    foot = np.array([(low[0] + high[0]) / 2, low[1], (low[2] + high[2]) / 2])
    return mesh.warped(lambda vertices: (vertices - foot) * scale)


def random_box(diagonal: float, rng: np.random.Generator) -> Mesh:
    """A box of random sides, its middle at the origin."""
    sides = rng.uniform(0.15, 1.0, 3)
    half = sides * (diagonal / 2 / np.linalg.norm(sides))
    return box(-half, half)


def simple_thing(rng: np.random.Generator) -> Mesh:
    """A box or a can of any size and proportions."""
    if rng.random() < 0.6:
        return random_box(1.0, rng)
    return cylinder((0, 0, 0), (0, 1, 0), rng.uniform(0.15, 0.8), 20)


def _procedural(rng: np.random.Generator, category: str) -> Mesh:
    other = get_category(str(rng.choice([name for name in GENERATORS if name != category])))
    model = generate(other, int(rng.integers(2**31)), "train", int(rng.integers(2**31)))
    return merge_meshes(model.posed(random_states(model.limits, other.joints, rng)))
