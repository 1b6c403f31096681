"""Drawing objects: a window into the image, smoothly shaded parts, keypoints, joint axes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes

from ..camera import Camera
from ..objects import ObjectModel
from ..render import NOTHING, rasterise
from ..report import PART_COLOURS
from .style import INK, keypoint_colours

SMOOTH = 3
"""Pixels rendered for each one drawn, per side."""
LIGHT = np.array([-0.45, -0.75, -0.55]) / np.linalg.norm([-0.45, -0.75, -0.55])
"""Towards the lamp, camera frame: from above, left and behind the camera."""
GREY = np.array([0.80, 0.82, 0.85])
"""Of an object that only stands behind what is shown."""
MARGIN = 0.07
"""Around what a window shows, as a share of its size."""
PIXELS = 300
"""Width of a drawn object."""


@dataclass(frozen=True)
class Window:
    """A part of an image as a camera of its own, so that everything drawn in it shares its pixels."""

    camera: Camera

    @classmethod
    def around(cls, camera: Camera, points: np.ndarray, aspect: float, foot: float = 0.0) -> Window:
        """What shows camera-frame ``points`` (N, 3); a height of ``aspect`` times the width, of which ``foot`` stays
        free for a caption."""
        u = camera.fx * points[:, 0] / points[:, 2] + camera.cx
        v = camera.fy * points[:, 1] / points[:, 2] + camera.cy
        width = (1 + 2 * MARGIN) * max(float(np.ptp(u)), float(np.ptp(v)) / (aspect * (1 - foot)))
        left = (u.min() + u.max() - width) / 2
        top = (v.min() + v.max() - width * aspect * (1 - foot)) / 2
        scale = PIXELS / width
        return cls(
            Camera(
                width=PIXELS,
                height=round(PIXELS * aspect),
                fx=camera.fx * scale,
                fy=camera.fy * scale,
                cx=(camera.cx - left) * scale,
                cy=(camera.cy - top) * scale,
            )
        )

    def project(self, points: np.ndarray) -> np.ndarray:
        """(N, 3) camera frame -> (N, 2) pixels."""
        camera = self.camera
        return points[:, :2] / points[:, 2:] * (camera.fx, camera.fy) + (camera.cx, camera.cy)

    def open(self, panel: Axes) -> None:
        """Make ``panel`` show this window and nothing around."""
        panel.set_axis_off()
        panel.set_xlim(0, self.camera.width)
        panel.set_ylim(self.camera.height, 0)


def studio(points: np.ndarray, aspect: float, foot: float = 0.0) -> tuple[np.ndarray, Window]:
    """A long lens on canonical ``points`` (N, 3), from the front and the side, the higher the flatter they lie:
    T_camera_base and a window."""
    size = np.ptp(points, axis=0)
    azimuth, elevation = np.radians(35), np.radians(np.interp(size[1] / size[[0, 2]].max(), [0.1, 0.5], [62, 28]))
    toward = np.array([np.sin(azimuth) * np.cos(elevation), np.sin(elevation), np.cos(azimuth) * np.cos(elevation)])
    right = np.cross(-toward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(-toward, right), -toward])
    centre = (points.min(0) + points.max(0)) / 2
    far = 6 * float(np.linalg.norm(points - centre, axis=1).max())
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation, [0, 0, far]
    T[:3, 3] -= rotation @ centre
    seen = points @ T[:3, :3].T + T[:3, 3]
    return T, Window.around(Camera(PIXELS, PIXELS, 1.0, 1.0, 0.0, 0.0), seen, aspect, foot)


def paint(
    panel: Axes,
    window: Window,
    model: ObjectModel,
    states: np.ndarray,
    T_camera_base: np.ndarray,
    colours: np.ndarray | None = None,
    pale: float = 0.0,
) -> None:
    """Draw ``model``, a colour a part (or ``colours`` (K, 3)), mixed with white by ``pale``."""
    vertices = model.posed_vertices(states, T_camera_base)
    colours = PART_COLOURS[np.arange(len(vertices)) % len(PART_COLOURS)] if colours is None else colours
    image = shaded(window, vertices, [part.faces for part in model.parts], colours * (1 - pale) + pale)
    panel.imshow(image, extent=(0, window.camera.width, window.camera.height, 0), interpolation="antialiased")
    window.open(panel)


def shaded(
    window: Window, vertices: Sequence[np.ndarray], faces: Sequence[np.ndarray], colours: np.ndarray
) -> np.ndarray:
    """(H, W, 3) picture of parts in the camera frame under a lamp, with dark outlines, on white."""
    c = window.camera
    big = Camera(
        c.width * SMOOTH, c.height * SMOOTH, c.fx * SMOOTH, c.fy * SMOOTH,
        (c.cx + 0.5) * SMOOTH - 0.5, (c.cy + 0.5) * SMOOTH - 0.5,
    )  # fmt: skip
    first = np.cumsum([0] + [len(v) for v in vertices[:-1]])
    points, triangles = np.concatenate(vertices), np.concatenate([f + n for f, n in zip(faces, first, strict=True)])
    parts = np.repeat(np.arange(len(faces), dtype=np.uint8), [len(f) for f in faces])
    seen = rasterise(points, triangles, parts, big)
    lit = rasterise(points, triangles, _brightness(points[triangles]), big).labels
    image = np.ones((*seen.labels.shape, 3))
    there = seen.labels != NOTHING
    image[there] = np.clip(colours[seen.labels[there]] * (lit[there, None] / 200), 0, 1)
    image[_outline(seen.labels, seen.depth)] *= 0.62
    return image.reshape(c.height, SMOOTH, c.width, SMOOTH, 3).mean((1, 3))


def _brightness(triangles: np.ndarray) -> np.ndarray:
    """(F,) uint8 of triangles (F, 3, 3); 200 keeps a part's colour."""
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True) + 1e-30
    away = (normals * triangles[:, 0]).sum(1) > 0
    lit = np.clip(np.where(away[:, None], -normals, normals) @ LIGHT, 0, 1)
    return (120 + 100 * lit).astype(np.uint8)


def _outline(labels: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """(H, W) bool: pixels of an object on the edge of a part, or where the surface behind is much farther."""
    edge = np.zeros(labels.shape, dtype=bool)
    step = 0.03 * float(np.ptp(depth[depth > 0])) if (depth > 0).any() else 1.0
    for axis in (0, 1):
        a, b = (np.moveaxis(values, axis, 0) for values in (labels, depth))
        jump = (a[1:] != a[:-1]) | (np.abs(b[1:] - b[:-1]) > step)
        into = np.moveaxis(edge, axis, 0)
        into[1:] |= jump
        into[:-1] |= jump
    return edge & (labels != NOTHING)


def draw_cloud(panel: Axes, window: Window, points: np.ndarray, colours: np.ndarray, size: float = 1.2) -> None:
    """Points (N, 3) of the camera frame; one colour or (N, 3)."""
    step = -(-len(points) // 5000)
    uv = window.project(points[::step])
    kept = colours[::step] if colours.ndim == 2 else colours[None]
    panel.scatter(*uv.T, s=size, c=kept, linewidths=0)


def draw_keypoints(panel: Axes, window: Window, keypoints: np.ndarray, size: float = 17.0) -> None:
    """Keypoints (M, 3) of the camera frame, far ones first, coloured by index."""
    far_first = np.argsort(-keypoints[:, 2])
    uv, colours = window.project(keypoints)[far_first], keypoint_colours(len(keypoints))[far_first]
    panel.scatter(*uv.T, s=size, c=colours, edgecolors="white", linewidths=0.5, zorder=3)


@dataclass(frozen=True)
class Arrow:
    """A joint's axis as it is drawn, camera frame."""

    tail: np.ndarray
    tip: np.ndarray

    @classmethod
    def along(cls, axis: np.ndarray, pivot: np.ndarray, part: np.ndarray) -> Arrow:
        """Through ``pivot``, a bit longer than the ``part`` (n, 3) that it moves; through the part's middle where the
        pivot is not finite (a prismatic joint)."""
        through = pivot if np.isfinite(pivot).all() else part.mean(0)
        reach = (part - through) @ axis
        beyond = 0.14 * float(np.linalg.norm(np.ptp(part, axis=0)))
        return cls(through + (reach.min() - beyond) * axis, through + (reach.max() + 1.6 * beyond) * axis)


def arrows(
    axes: np.ndarray, pivots: np.ndarray, keypoints: np.ndarray, part_of: Sequence[int] | np.ndarray
) -> list[Arrow]:
    """Joint axes (J, 3) through ``pivots`` (J, 3), NaN for prismatic joints, as long as the ``keypoints`` (M, 3) of the
    parts that they move."""
    parts = [keypoints[np.asarray(part_of) == joint + 1] for joint in range(len(axes))]
    return [Arrow.along(*each) for each in zip(axes, pivots, parts, strict=True)]


def draw_arrows(panel: Axes, window: Window, found: Sequence[Arrow], colour: str, dotted: bool = False) -> None:
    """Joint axes as arrows, or as dotted lines."""
    for arrow in found:
        a, b = window.project(np.stack([arrow.tail, arrow.tip]))
        if dotted:
            panel.plot(*np.stack([a, b]).T, color=colour, linewidth=1.2, linestyle=(0, (1, 1.4)), zorder=5)
            continue
        panel.annotate(
            "", xy=tuple(b), xytext=tuple(a), zorder=4, annotation_clip=False,
            arrowprops={"arrowstyle": "-|>,head_width=0.16,head_length=0.32", "color": colour, "linewidth": 1.5,
                        "shrinkA": 0, "shrinkB": 0},
        )  # fmt: skip


def caption(panel: Axes, text: str, colour: str = INK) -> None:
    """Small text at the bottom left of a panel."""
    panel.text(
        0.02, 0.01, text, transform=panel.transAxes, fontsize=6.8, color=colour, va="bottom", zorder=6,
        bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 0.8},
    )  # fmt: skip
