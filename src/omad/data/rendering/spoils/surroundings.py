"""What stands about an object: table, wall, shelf, neighbours. Lengths in metres, in the object's base frame (y up)."""

import numpy as np
from scipy.spatial.transform import Rotation

from omad.data.procedural.shapes import box
from omad.geometry.mesh import Mesh
from omad.geometry.rigid import box as bounds
from omad.geometry.rigid import carry, diagonal, rigid

from .spoil import Place
from .things import random_thing

GAP = (0.05, 1.0)
"""Between object and wall, shares of the object's diagonal; small gaps are as frequent as large ones."""
TILT = np.radians(25)
"""A wall faces the camera, but for this."""
WIDE = 4.0
"""Half the width of tables and walls, diagonals of the object."""
BOARD = 0.05
"""Thickness of boards, diagonals."""
NEIGHBOURS = (2, 5)
CLEARANCE = (0.03, 0.4)
"""Between object and neighbour, diagonals."""


def surroundings(
    place: Place, outline: np.ndarray, eye: np.ndarray, rng: np.random.Generator, category: str
) -> tuple[list[Mesh], list[Mesh]]:
    """Boards and walls, and neighbours, for an object that ``outline`` (V, 3) bounds, seen from ``eye`` (3,);
    neighbours are of other categories than the object's."""
    makers = {"nothing": [], "wall": [_wall], "table": [_table], "shelf": [_shelf], "clutter": [_table, _wall]}[place]
    size = diagonal(outline)
    boards = [mesh for maker in makers for mesh in maker(outline, eye, size, rng)]
    return boards, _neighbours(outline, size, rng, category) if place == "clutter" else []


def _gap(size: float, rng: np.random.Generator) -> float:
    return size * float(np.exp(rng.uniform(*np.log(GAP))))


def _frame_towards(direction: np.ndarray, middle: np.ndarray) -> np.ndarray:
    """(4, 4) of a frame at ``middle`` whose z axis points along ``direction`` (3,) and whose x axis is level."""
    z = direction / np.linalg.norm(direction)
    x = np.cross([0.0, 1.0, 0.0], z)
    x = x / np.linalg.norm(x) if np.linalg.norm(x) > 1e-6 else np.array([1.0, 0.0, 0.0])
    return rigid(np.stack([x, np.cross(z, x), z], 1), middle)


def _wall(outline: np.ndarray, eye: np.ndarray, size: float, rng: np.random.Generator) -> list[Mesh]:
    """A plane behind the object that faces the camera, more or less."""
    middle = bounds(outline).mean(0)
    tilt = Rotation.from_rotvec(TILT * rng.uniform(-1, 1, 3) / np.sqrt(3)).as_matrix()
    T = _frame_towards(tilt @ (eye - middle), middle)
    behind = carry(np.linalg.inv(T), outline)[:, 2].min() - _gap(size, rng)
    wide = 2 * WIDE * size
    return [box((-wide, -wide, behind - BOARD * size), (wide, wide, behind)).carried(T)]


def _table(outline: np.ndarray, eye: np.ndarray, size: float, rng: np.random.Generator) -> list[Mesh]:
    """A board under the object, whose edges may be in the picture."""
    low, high = bounds(outline)
    left, back, right, front = size * rng.uniform(0.1, WIDE, 4)
    edge = box((low[0] - left, low[1] - BOARD * size, low[2] - back), (high[0] + right, low[1], high[2] + front))
    return [edge]


def _shelf(outline: np.ndarray, eye: np.ndarray, size: float, rng: np.random.Generator) -> list[Mesh]:
    """Boards below, above, on both sides and behind the object, open to the camera."""
    middle = bounds(outline).mean(0)
    level = (eye - middle) * [1.0, 0.0, 1.0]
    T = _frame_towards(level if np.linalg.norm(level) > 1e-6 else np.array([0.0, 0.0, 1.0]), middle)
    low, high = bounds(carry(np.linalg.inv(T), outline))
    x0, x1 = low[0] - _gap(size, rng), high[0] + _gap(size, rng)
    y0, y1 = low[1], high[1] + _gap(size, rng)
    z0, z1 = low[2] - _gap(size, rng), high[2] + 0.1 * size
    board = BOARD * size
    boards = [
        box((x0, y0 - board, z0), (x1, y0, z1)),
        box((x0, y0 - board, z0 - board), (x1, y1 + board, z0)),
        box((x0 - board, y0 - board, z0 - board), (x0, y1 + board, z1)),
        box((x1, y0 - board, z0 - board), (x1 + board, y1 + board, z1)),
        box((x0, y1, z0), (x1, y1 + board, z1)),
    ]
    return [each.carried(T) for each in boards]


def _neighbours(outline: np.ndarray, size: float, rng: np.random.Generator, category: str) -> list[Mesh]:
    """Things that stand where the object stands, clear of it."""
    low, high = bounds(outline)
    middle, reach = (low + high) / 2, float(np.linalg.norm((high - low)[[0, 2]])) / 2
    things = []
    for _ in range(int(rng.integers(*NEIGHBOURS, endpoint=True))):
        thing = random_thing(size * float(rng.uniform(0.3, 1.1)), rng, category)
        away = reach + float(np.linalg.norm(thing.vertices[:, [0, 2]], axis=1).max()) + size * rng.uniform(*CLEARANCE)
        angle = rng.uniform(0, 2 * np.pi)
        place = [middle[0] + away * np.sin(angle), low[1], middle[2] + away * np.cos(angle)]
        things.append(thing.warped(lambda vertices, place=place: vertices + place))
    return things
