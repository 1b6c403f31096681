"""An object and what stands about it, rendered once, to be spoilt in many ways."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from omad.geometry.camera import STANDARD_CAMERA, Camera
from omad.geometry.rigid import box, carry, rigid
from omad.objects.category import Category
from omad.objects.model import ObjectModel
from omad.objects.pose import ObjectPose

from ..rasteriser import NOTHING, Rendering, rasterise, render
from ..standard_views import ObjectTruth, View, draw
from .spoil import Staging
from .surroundings import surroundings

SIZES = ((320, 240), (424, 240), (512, 424), (640, 480), (848, 480), (1280, 720))
FOCAL = (0.5, 1.2)
"""Focal length as a share of the image's width ..."""
FOCAL_LIMITS = (300.0, 1100.0)
"""... and in pixels."""
DISTANCES = (0.25, 5.0)
"""Metres at which real cameras work."""
BACKGROUND, OBJECT, FIRST_OTHER = 0, 1, 2
"""Numbers of an instance image: what others stand on or before, the object, the first of the other things."""
AWAY = np.radians(60)
"""The camera is turned no farther to leave a part of the object out of its image."""
HIDES = 0.002
"""What hides more than this share of the object's pixels is left out of its surroundings."""


@dataclass(frozen=True)
class SpoilScene:
    """Exact images and their truth."""

    truth: ObjectTruth
    states: np.ndarray
    """(J,) radians or metres."""
    T_camera_base: np.ndarray
    """(4, 4)."""
    camera: Camera
    seed: tuple[int, ...]
    thing: Rendering
    """The object alone, labelled by part; never nothing."""
    around: Rendering
    """All else without the object, labelled BACKGROUND or by instance."""
    mask: np.ndarray | None = None
    """(H, W) bool, what is given out as the object, rightly or not; None: what is seen of it."""

    @property
    def distance(self) -> float:
        """Of the object, metres along z."""
        return float(np.median(self.thing.depth[self.thing.depth > 0]))


def random_camera(rng: np.random.Generator) -> Camera:
    """One of the sizes of real cameras, with a focal length that real ones have, its axis through the middle."""
    width, height = SIZES[rng.integers(len(SIZES))]
    focal = float(np.clip(width * rng.uniform(*FOCAL), *FOCAL_LIMITS))
    return Camera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)


def draw_scene(model: ObjectModel, category: Category, seed: Sequence[int], staging: Staging) -> SpoilScene:
    """``model`` at random joint states, staged; the same for the same ``seed`` (any non-negative integers). With the
    default staging it is the standard view of that seed. Raises InputError for an object that cannot be seen."""
    rng = np.random.default_rng(list(seed))
    generator = torch.Generator().manual_seed(int(rng.integers(2**62)))
    camera = random_camera(rng) if staging.any_camera else STANDARD_CAMERA
    drawn = draw(model, category, generator, camera, views=staging.views(category.views))
    T_camera_base, rendering = drawn.T_camera_base, drawn.rendering
    outline = np.concatenate(model.posed_vertices(drawn.states))
    moved = T_camera_base
    if staging.any_camera:
        moved = _within_reach(moved, outline)
    if staging.cut_off > 0:
        moved = _run_out(moved, rendering, camera, staging.cut_off, rng)
    if moved is not T_camera_base:
        rendering = render(model, drawn.states, moved, camera)
    truth = ObjectTruth.of(model)
    around = _around(staging, outline, moved, rendering, camera, rng, category)
    return SpoilScene(truth, drawn.states, moved, camera, tuple(seed), rendering, around)


def scene_of(view: View, category: Category, staging: Staging) -> SpoilScene | None:
    """A view that is there already: its mask and what its frame shows beside the object stay; where that is nothing, it
    is given surroundings. None where the staging asks for another viewpoint or camera, or nothing of the object is
    seen."""
    on = view.labels != NOTHING
    if replace(staging, place="nothing") != Staging() or not on.any():
        return None
    thing = _layer(view.depth, on, view.labels)
    beside = (view.depth > 0) & ~on
    around = _layer(view.depth, beside, np.full_like(view.labels, BACKGROUND))
    if not beside.any():
        rng = np.random.default_rng([*view.seed, 1])
        outline, pose = _part_corners(view, category), view.T_camera_base
        around = _around(staging, outline, pose, thing, view.camera, rng, category)
    return SpoilScene(view.truth, view.states, view.T_camera_base, view.camera, view.seed, thing, around, view.mask)


def _layer(depth: np.ndarray, shown: np.ndarray, labels: np.ndarray) -> Rendering:
    """What an image shows where ``shown`` (H, W); what has been measured counts as seen squarely."""
    kept = np.where(shown, depth, np.float32(0))
    return Rendering(kept, np.where(shown, labels, np.uint8(NOTHING)), shown.astype(np.float32))


def _part_corners(view: View, category: Category) -> np.ndarray:
    """(8 K, 3) corners of the parts' boxes where they are, base frame."""
    placed = (view.truth.axes, view.truth.pivots, view.states, np.eye(4))
    tensors = (torch.as_tensor(values, dtype=torch.float64)[None] for values in placed)
    [pose] = ObjectPose.at(category.metric_tree, *tensors).rows()
    which = np.stack(np.meshgrid([0, 1], [0, 1], [0, 1]), -1).reshape(-1, 3)
    boxes = zip(pose.T_camera_part, view.truth.part_boxes, strict=True)
    return np.concatenate([carry(T, limits[which, np.arange(3)]) for T, limits in boxes])


def _within_reach(T_camera_base: np.ndarray, outline: np.ndarray) -> np.ndarray:
    """The object brought to a distance of DISTANCES along the line of sight."""
    middle = carry(T_camera_base, box(outline).mean(0))
    factor = float(np.clip(middle[2], *DISTANCES)) / middle[2]
    return rigid(np.eye(3), (factor - 1) * middle) @ T_camera_base


def _run_out(
    T_camera_base: np.ndarray, rendering: Rendering, camera: Camera, share: float, rng: np.random.Generator
) -> np.ndarray:
    """The camera turned away, by which it sees no other side of the object, until ``share`` of the pixels that show it
    are beyond a border of the image."""
    rows, columns = np.nonzero(rendering.depth)
    points = camera.backproject(np.stack([columns, rows], 1), rendering.depth[rows, columns])
    border = rng.integers(4)
    axis = np.array([(0.0, 1.0, 0.0), (0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (-1.0, 0.0, 0.0)][border])
    near, far = -AWAY, AWAY
    for _ in range(30):
        turn = Rotation.from_rotvec((near + far) / 2 * axis).as_matrix()
        turned = points @ turn.T
        column, row = camera.project(turned).T
        beyond = (column > camera.width - 0.5, column < -0.5, row < -0.5, row > camera.height - 0.5)[border]
        # so many pixels of the turned image show what one showed
        pixels = (points[:, 2] / np.maximum(turned[:, 2], 1e-3)) ** 3
        if pixels[beyond].sum() < share * pixels.sum():
            near = (near + far) / 2
        else:
            far = (near + far) / 2
    return rigid(turn, np.zeros(3)) @ T_camera_base


def _around(
    staging: Staging,
    outline: np.ndarray,
    T_camera_base: np.ndarray,
    thing: Rendering,
    camera: Camera,
    rng: np.random.Generator,
    category: Category,
) -> Rendering:
    """What stands about the object, but for what would hide it."""
    eye = np.linalg.inv(T_camera_base)[:3, 3]
    boards, neighbours = surroundings(staging.place, outline, eye, rng, category.name)
    merged = _layer(np.zeros_like(thing.depth), np.zeros(thing.depth.shape, dtype=bool), thing.labels)
    seen, instance = thing.depth > 0, FIRST_OTHER
    for number, mesh in enumerate([*boards, *neighbours]):
        placed = mesh.carried(T_camera_base)
        label = BACKGROUND if number < len(boards) else instance
        labels = np.full(len(mesh.faces), label, dtype=np.uint8)
        rendering = rasterise(placed.vertices, placed.faces, labels, camera)
        before = (rendering.depth > 0) & (rendering.depth < thing.depth)
        if before[seen].mean() <= HIDES:
            merged = in_front(rendering, merged)
            instance += label == instance
    return merged


def in_front(one: Rendering, other: Rendering) -> Rendering:
    """Both, each where it is the nearer; the first where they are equally near."""
    first = (one.depth > 0) & ((other.depth == 0) | (one.depth <= other.depth))
    layers = ((getattr(one, name), getattr(other, name)) for name in ("depth", "labels", "cos_view"))
    return Rendering(*(np.where(first, a, b) for a, b in layers))
