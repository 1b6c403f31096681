"""Drawing objects: a crop of the image, smoothly shaded parts, keypoints, joint axes."""

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from omad.data.rendering.rasteriser import NOTHING, rasterise, render_parts
from omad.data.rendering.viewpoints import pose_before
from omad.geometry.camera import Camera
from omad.geometry.mesh import Mesh, merge_meshes, triangle_normals
from omad.geometry.rigid import bounding_sphere, box, carry, diagonal
from omad.objects.category import Category
from omad.output.picture import part_colours

from .style import INK, keypoint_colours

SMOOTH = 3
"""Pixels rendered for each one drawn, per side."""
LIGHT = np.array([-0.45, -0.75, -0.55]) / np.linalg.norm([-0.45, -0.75, -0.55])
"""Towards the lamp, camera frame: from above, left and behind the camera."""
GREY = np.array([0.80, 0.82, 0.85])
"""Of an object that only stands behind what is shown."""
MARGIN = 0.07
"""Around what a crop shows, as a share of its size."""
PIXELS = 300
"""Width of a drawn object."""


def crop_around(camera: Camera, points: np.ndarray, aspect: float, foot: float = 0.0) -> Camera:
    """The part of an image that shows camera-frame ``points`` (N, 3), as a camera of its own, so that all that is drawn
    shares its pixels; a height of ``aspect`` times the width, of which ``foot`` stays free for a caption."""
    pixels = camera.project(points)
    tall = aspect * (1 - foot)
    width = (1 + 2 * MARGIN) * float((np.ptp(pixels, axis=0) / (1, tall)).max())
    left, top = (box(pixels).sum(0) - (width, width * tall)) / 2
    return camera.zoomed(PIXELS / width, left, top, (PIXELS, round(PIXELS * aspect)))


def open_panel(panel: Axes, crop: Camera) -> None:
    """Make ``panel`` show this camera's image and nothing around."""
    panel.set_axis_off()
    panel.set(xlim=(-0.5, crop.width - 0.5), ylim=(crop.height - 0.5, -0.5))  # pixel centres are at integers


def studio(points: np.ndarray, aspect: float, foot: float = 0.0) -> tuple[np.ndarray, Camera]:
    """A long lens on canonical ``points`` (N, 3), from the front and the side, the higher the flatter they lie:
    T_camera_base and the camera."""
    size = np.ptp(points, axis=0)
    elevation = float(np.radians(np.interp(size[1] / size[[0, 2]].max(), [0.1, 0.5], [62, 28])))
    centre, radius = bounding_sphere(points)
    T = pose_before(6 * radius, math.radians(35), elevation, centre)
    return T, crop_around(Camera(PIXELS, PIXELS, 1.0, 1.0, 0.0, 0.0), carry(T, points), aspect, foot)


def paint(panel: Axes, crop: Camera, parts: Sequence[Mesh], pale: float, grey: bool = False) -> None:
    """Draw parts in the camera frame, a colour a part or all of them ``GREY``, mixed with white by ``pale``."""
    colours = np.tile(GREY, (len(parts), 1)) if grey else part_colours(np.arange(len(parts)))
    image = shaded(crop, parts, colours * (1 - pale) + pale)
    panel.imshow(image, extent=(-0.5, crop.width - 0.5, crop.height - 0.5, -0.5), interpolation="antialiased")
    open_panel(panel, crop)


def shaded(crop: Camera, parts: Sequence[Mesh], colours: np.ndarray) -> np.ndarray:
    """(H, W, 3) picture of parts in the camera frame under a lamp, with dark outlines, on white."""
    corner = 0.5 / SMOOTH - 0.5  # pixel centres are at integers
    big = crop.zoomed(SMOOTH, corner, corner)
    whole, seen = merge_meshes(parts), render_parts(parts, big)
    lit = rasterise(whole.vertices, whole.faces, _brightness(whole.triangles), big).labels
    image, there = np.ones((*seen.labels.shape, 3)), seen.labels != NOTHING
    image[there] = np.clip(colours[seen.labels[there]] * (lit[there, None] / 200), 0, 1)
    image[_outline(seen.labels, seen.depth)] *= 0.62
    return image.reshape(crop.height, SMOOTH, crop.width, SMOOTH, 3).mean((1, 3))


def _brightness(triangles: np.ndarray) -> np.ndarray:
    """(F,) uint8 of triangles (F, 3, 3); 200 keeps a part's colour."""
    normals = triangle_normals(triangles)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True) + 1e-30
    away = (normals * triangles[:, 0]).sum(1) > 0
    lit = np.clip(np.where(away[:, None], -normals, normals) @ LIGHT, 0, 1)
    return (120 + 100 * lit).astype(np.uint8)


def _outline(labels: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """(H, W) bool: pixels of an object on the edge of a part, or where the surface behind is much farther."""
    edge = np.zeros(labels.shape, dtype=bool)
    step = 0.03 * float(np.ptp(depth[depth > 0])) if (depth > 0).any() else 1.0
    for axis in (0, 1):
        part, far, into = (np.moveaxis(values, axis, 0) for values in (labels, depth, edge))
        jump = (part[1:] != part[:-1]) | (np.abs(np.diff(far, axis=0)) > step)
        into[1:] |= jump
        into[:-1] |= jump
    return edge & (labels != NOTHING)


def draw_keypoints(panel: Axes, crop: Camera, keypoints: np.ndarray, size: float = 17.0) -> None:
    """Keypoints (M, 3) of the camera frame, far ones first, coloured by index."""
    far_first = np.argsort(-keypoints[:, 2])
    uv, colours = crop.project(keypoints)[far_first], keypoint_colours(len(keypoints))[far_first]
    panel.scatter(*uv.T, s=size, c=colours, edgecolors="white", linewidths=0.5, zorder=3)


def arrows(category: Category, axes: np.ndarray, pivots: np.ndarray, keypoints: np.ndarray) -> np.ndarray:
    """(J, 2, 3) tail and tip of joint axes (J, 3): through ``pivots`` (J, 3), or through the middle of the part where
    a joint slides, a bit longer than the ``keypoints`` (M, 3) of the part that moves."""
    part_of, found = np.array(category.part_of_keypoint), []
    for child, (axis, pivot, turns) in enumerate(zip(axes, pivots, category.turning, strict=True), start=1):
        part = keypoints[part_of == child]
        through = pivot if turns else part.mean(0)
        reach = (part - through) @ axis
        beyond = 0.14 * diagonal(part)
        found.append([through + (reach.min() - beyond) * axis, through + (reach.max() + 1.6 * beyond) * axis])
    return np.array(found)


def draw_arrows(panel: Axes, crop: Camera, found: np.ndarray, colour: str, dotted: bool = False) -> None:
    """Joint axes (J, 2, 3) as arrows, or as dotted lines."""
    for arrow in found:
        tail, tip = ends = crop.project(arrow)
        if dotted:
            panel.plot(*ends.T, color=colour, linewidth=1.2, linestyle=(0, (1, 1.4)), zorder=5)
            continue
        panel.annotate(
            "", xy=tuple(tip), xytext=tuple(tail), zorder=4, annotation_clip=False,
            arrowprops={"arrowstyle": "-|>,head_width=0.16,head_length=0.32", "color": colour, "linewidth": 1.5,
                        "shrinkA": 0, "shrinkB": 0},
        )  # fmt: skip


def caption(panel: Axes, text: str) -> None:
    """Small text at the bottom left of a panel."""
    panel.text(
        0.02, 0.01, text, transform=panel.transAxes, fontsize=6.8, color=INK, va="bottom", zorder=6,
        bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 0.8},
    )  # fmt: skip
