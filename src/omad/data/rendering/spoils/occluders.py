"""Something that stands between camera and object."""

import numpy as np
from scipy.spatial.transform import Rotation

from omad.geometry.camera import Camera
from omad.geometry.mesh import Mesh
from omad.geometry.rigid import rigid

from ..rasteriser import Rendering, rasterise
from .things import random_box, random_thing

NEARNESS = (0.5, 0.92)
"""How far off it is, as a share of the object's nearest depth."""
SPREAD = (1.2, 2.0)
"""Its size in the image, times the object's."""
TOLERANCE = 0.01
"""The share hidden is met this well."""
STEPS = 12
TRIES = 3
"""Things that cannot hide so much, having holes, give way to a box after so many."""


def occluder(seen: np.ndarray, depth: np.ndarray, camera: Camera, share: float, rng: np.random.Generator) -> Rendering:
    """What is rendered of a random thing that hides ``share`` of the pixels ``seen`` (H, W) of an object with ``depth``
    (H, W) metres: it is moved in from a random side, across the line of sight, until it hides so much."""
    rows, columns = np.nonzero(seen)
    middle = np.array([columns.mean(), rows.mean()])
    extent = float(np.hypot(np.ptp(columns) + 1, np.ptp(rows) + 1))
    nearest = float(depth[seen].min())
    best, missed = None, np.inf
    for attempt in range(TRIES + 1):
        away = nearest * rng.uniform(*NEARNESS)
        size = extent * rng.uniform(*SPREAD) * away / camera.fx
        size = min(size, 1.2 * (nearest - away) + 0.5 * away)  # neither into the object nor into the camera
        thing = random_thing(size, rng) if attempt < TRIES else random_box(size, rng)
        turned = thing.carried(rigid(Rotation.from_quat(rng.standard_normal(4)).as_matrix(), np.zeros(3)))
        turned = turned.warped(lambda vertices: vertices - (vertices.min(0) + vertices.max(0)) / 2)
        foremost = np.array([0.0, 0.0, max(away, 1.05 * turned.vertices[:, 2].max())])
        angle = rng.uniform(0, 2 * np.pi)
        found = _moved_in(turned.warped(lambda v, at=foremost: v + at), seen, camera, share, middle, extent, angle)
        covered = abs(float((found.depth > 0)[seen].mean()) - share)
        if covered < missed:
            best, missed = found, covered
        if missed <= TOLERANCE:
            break
    assert best is not None
    return best


def _moved_in(
    mesh: Mesh, seen: np.ndarray, camera: Camera, share: float, middle: np.ndarray, extent: float, angle: float
) -> Rendering:
    """Bisection between beside the object (hides nothing) and before it."""
    away, direction = mesh.vertices[:, 2].mean(), np.array([np.cos(angle), np.sin(angle)])
    widest = np.hypot(*np.ptp(mesh.vertices[:, :2], axis=0)) * camera.fx / mesh.vertices[:, 2].min()
    near, far = 0.0, (extent + widest) / 1.5
    labels = np.zeros(len(mesh.faces), dtype=np.uint8)
    best, missed = None, np.inf
    for _ in range(STEPS):
        tried = (near + far) / 2
        at = (middle + tried * direction - (camera.cx, camera.cy)) / (camera.fx, camera.fy) * away
        rendering = rasterise(mesh.vertices + [*at, 0.0], mesh.faces, labels, camera)
        covered = float((rendering.depth > 0)[seen].mean())
        near, far = (near, tried) if covered < share else (tried, far)
        if abs(covered - share) < missed:
            best, missed = rendering, abs(covered - share)
        if missed <= TOLERANCE:
            break
    assert best is not None
    return best
