"""Several objects on one table or floor, some of a category and some of none, with the truth about each."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Literal

import numpy as np

from omad.data.procedural import generate
from omad.data.procedural.shapes import box
from omad.geometry.camera import STANDARD_CAMERA, Camera
from omad.geometry.mesh import Mesh, merge_meshes
from omad.geometry.rigid import box as bounds
from omad.geometry.rigid import carry, diagonal
from omad.objects.category_file import get_category

from .depth_noise import NoiseLevel, add_noise
from .rasteriser import rasterise
from .spoils.scenes import in_front
from .spoils.things import simple_thing, standing
from .viewpoints import pose_before, random_states

OBJECTS = (3, 6)
"""On one table."""
OTHERS = 0.4
"""Share of them that are boxes and cans, half of them at most."""
ELEVATION = np.radians((20.0, 50.0))
"""Of the camera over the table."""
CLEARANCE = 0.15
"""Between two objects' footprints at least, as a share of the larger one's radius."""
CROWDED = 1.15
"""The table's radius grows by this factor until one more object has a place on it."""
FILLS = 0.85
"""Of the image's width or height, by the objects."""
SEEN, MIN_PIXELS = 0.6, 500
"""An object is there to be found where this share of it is seen, and so many pixels."""
TABLE_HEIGHT, TABLE_BOARD, TABLE_LEG = (0.4, 0.9), 0.03, 0.05
"""Metres, of a table that stands on a floor; its legs are square."""
TABLE_EDGE = (0.05, 0.4)
"""Metres from the objects to each edge of such a table."""
BEFORE_WALL = (0.02, 1.0)
"""Metres from the objects or from the table's edge to the wall behind."""
ROOM = 10.0
"""Metres to every side: its floor and wall run out of the image."""


@dataclass(frozen=True)
class TabletopObject:
    """One object where it stands."""

    category: str | None
    """None: a box or a can."""
    mask: np.ndarray
    """(H, W) bool, the pixels that show it, measured or not."""
    states: np.ndarray
    """(J,) radians or metres at the size it has here; of other things (0,)."""
    visible: float
    """Share of its pixels that nothing hides; what a border cuts off has none."""

    @property
    def to_be_found(self) -> bool:
        """Whether enough of it is seen."""
        return bool(self.visible >= SEEN and np.count_nonzero(self.mask) >= MIN_PIXELS)


@dataclass(frozen=True)
class Tabletop:
    """A depth image of several objects, and what they are."""

    depth: np.ndarray
    """(H, W) float32 metres, 0 = no measurement."""
    camera: Camera
    objects: tuple[TabletopObject, ...]


@dataclass(frozen=True)
class Surroundings:
    """What the objects stand on, and before."""

    raised: bool = False
    """On a table with legs, which ends beside them, over a floor; otherwise on the floor itself."""
    wall: bool = False
    """Before a wall."""


@dataclass(frozen=True)
class _Thing:
    category: str | None
    states: np.ndarray
    mesh: Mesh
    """Its foot at y = 0, its middle on the y axis, metres."""

    @property
    def radius(self) -> float:
        """Of its footprint."""
        return float(np.linalg.norm(self.mesh.vertices[:, [0, 2]], axis=1).max())


def draw_tabletop(
    categories: Sequence[str],
    seed: Sequence[int],
    split: Literal["train", "test"] = "test",
    noise: NoiseLevel | None = None,
    largest: float = np.inf,
    surroundings: Surroundings | None = None,
) -> Tabletop:
    """Objects of ``categories`` beside boxes and cans on a board that fills the image, or in other ``surroundings``;
    the same for the same arguments. Objects have their real sizes, but for those with a diagonal of more than
    ``largest`` metres, which are shrunk to that; ``split`` is that of ``generate``, ``seed`` any non-negative
    integers."""
    rng = np.random.default_rng(list(seed))
    count = int(rng.integers(*OBJECTS, endpoint=True))
    others = min(int(rng.binomial(count, OTHERS)), count // 2)
    things = [_of_category(str(rng.choice(list(categories))), split, largest, rng) for _ in range(count - others)]
    sizes = [diagonal(thing.mesh.vertices) for thing in things]
    for _ in range(others):
        mesh, turn = simple_thing(rng), rng.uniform(0, 2 * np.pi)
        size = float(rng.choice(sizes)) * rng.uniform(0.3, 1)
        things.append(_Thing(None, np.zeros(0), standing(mesh, turn, size / diagonal(mesh.vertices))))
    placed = [
        thing.mesh.warped(lambda vertices, at=at: vertices + at)
        for thing, at in zip(things, _places(things, rng), strict=True)
    ]
    everything = np.concatenate([mesh.vertices for mesh in placed])
    [aside] = rng.spawn(1)  # the same objects and view in all surroundings
    around = _board(everything) if surroundings is None else _room(everything, surroundings, aside)
    return _seen(things, placed, around, noise, rng)


def _of_category(name: str, split: Literal["train", "test"], largest: float, rng: np.random.Generator) -> _Thing:
    category = get_category(name)
    model = generate(category, int(rng.integers(2**31)), split, int(rng.integers(2**31)))
    states = random_states(model.limits, category.joints, rng)
    mesh = merge_meshes(model.posed(states))
    size = diagonal(mesh.vertices)
    turn = rng.uniform(-category.views.azimuth, category.views.azimuth)
    shrunk = np.where(category.turning, 1.0, min(largest / size, 1.0))
    return _Thing(name, states * shrunk, standing(mesh, turn, min(size, largest) / size))


def _places(things: Sequence[_Thing], rng: np.random.Generator) -> list[np.ndarray]:
    """(3,) each, near to each other and clear of each other."""
    places: list[np.ndarray] = []
    reach = things[0].radius
    for thing in things:
        while True:
            at = reach * np.array([rng.uniform(-1.3, 1.3), 0.0, rng.uniform(-1, 1)])
            before = zip(things, places, strict=False)
            if all(np.linalg.norm(at - other) > _apart(thing, one) for one, other in before):
                break
            reach *= CROWDED
        places.append(at)
    return places


def _apart(one: _Thing, other: _Thing) -> float:
    return one.radius + other.radius + CLEARANCE * max(one.radius, other.radius)


def _board(points: np.ndarray) -> Mesh:
    """A board under ``points`` (V, 3) that reaches far beyond them."""
    low, high = bounds(points)
    size = float(np.linalg.norm(high - low))
    return box((low[0] - size, -0.05 * size, low[2] - size), (high[0] + size, 0.0, high[2] + size))


def _room(points: np.ndarray, surroundings: Surroundings, rng: np.random.Generator) -> Mesh:
    """Floor, and where they are there table and wall, about ``points`` (V, 3) that stand at y = 0."""
    low, high = bounds(points)
    x0, z0 = low[[0, 2]] - rng.uniform(*TABLE_EDGE, 2)
    x1, z1 = high[[0, 2]] + rng.uniform(*TABLE_EDGE, 2)
    floor = -float(rng.uniform(*TABLE_HEIGHT))
    behind = float(rng.uniform(*BEFORE_WALL))
    meshes = list[Mesh]()
    if surroundings.raised:
        meshes.append(box((x0, -TABLE_BOARD, z0), (x1, 0.0, z1)))
        corners = product((x0, x1 - TABLE_LEG), (z0, z1 - TABLE_LEG))
        meshes += [box((x, floor, z), (x + TABLE_LEG, -TABLE_BOARD, z + TABLE_LEG)) for x, z in corners]
    else:
        floor, z0 = 0.0, low[2]
    wall = z0 - behind
    back = wall if surroundings.wall else z0 - ROOM
    meshes.append(box((x0 - ROOM, floor - TABLE_BOARD, back), (x1 + ROOM, floor, z1 + ROOM)))
    if surroundings.wall:
        meshes.append(box((x0 - ROOM, floor, wall - TABLE_BOARD), (x1 + ROOM, floor + ROOM, wall)))
    return merge_meshes(meshes)


def _seen(
    things: Sequence[_Thing], placed: Sequence[Mesh], around: Mesh, noise: NoiseLevel | None, rng: np.random.Generator
) -> Tabletop:
    camera = STANDARD_CAMERA
    everything = np.concatenate([mesh.vertices for mesh in placed])
    pose = _framing(everything, camera, rng.uniform(*ELEVATION), rng.uniform(-0.15, 0.15) * np.pi)
    shown = around.carried(pose)
    merged = rasterise(shown.vertices, shown.faces, np.zeros(len(shown.faces), dtype=np.uint8), camera)
    alone = []
    for number, mesh in enumerate(placed, 1):
        shown = mesh.carried(pose)
        alone.append(rasterise(shown.vertices, shown.faces, np.full(len(shown.faces), number, np.uint8), camera))
        merged = in_front(alone[-1], merged)
    objects = []
    for number, (thing, layer) in enumerate(zip(things, alone, strict=True), 1):
        mask = merged.labels == number
        share = np.count_nonzero(mask) / max(np.count_nonzero(layer.depth), 1)
        objects.append(TabletopObject(thing.category, mask, thing.states, share))
    return Tabletop(add_noise(merged.depth, noise, camera, rng, merged.cos_view), camera, tuple(objects))


def _framing(points: np.ndarray, camera: Camera, elevation: float, azimuth: float) -> np.ndarray:
    """T_camera_world (4, 4) of the camera from which ``points`` (V, 3) just fill the image."""
    centre = bounds(points).mean(0)
    near, far = 0.0, 20 * diagonal(points)
    for _ in range(30):
        distance = (near + far) / 2
        x, y, z = carry(pose_before(distance, azimuth, elevation, centre), points).T
        fits = (
            z.min() > 0
            and max(np.ptp(x / z) * camera.fx / camera.width, np.ptp(y / z) * camera.fy / camera.height) < FILLS
        )
        near, far = (near, distance) if fits else (distance, far)
    return pose_before(far, azimuth, elevation, centre)
