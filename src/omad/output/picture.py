"""Pictures of estimates."""

import io
import math
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import matplotlib.colors
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.text import Text
from PIL import Image

from omad.common.errors import InputError, as_line
from omad.common.files import write_atomic
from omad.data.rendering.rasteriser import NOTHING, Rendering, render, render_parts
from omad.estimation.estimate import Estimate, chance
from omad.estimation.part_labels import OUTSIDE
from omad.geometry.camera import NEAREST, STANDARD_CAMERA, Camera
from omad.geometry.rigid import box, carry, carry_each
from omad.model.surfaces.agreement import Overlay
from omad.objects.category import Category
from omad.objects.model import diagonal
from omad.objects.pose import ObjectPose
from omad.sensing.observation import Observation

PART_COLOURS = np.array(
    [
        *([0.35, 0.6, 0.95], [1.0, 0.6, 0.25], [0.45, 0.8, 0.4], [0.85, 0.4, 0.75]),
        *([0.95, 0.85, 0.2], [0.2, 0.75, 0.75], [0.8, 0.2, 0.2], [0.45, 0.3, 0.8]),
        [0.6, 0.6, 0.6],
    ]
)
"""Of parts by their number; the last one, grey, of what is none."""
DARKER = 0.6
"""Each round of parts than the one before, where an object has more of them than there are colours."""
DIFFERENCES = {
    "in_front": ("in front of what was seen", "#e8a000"),
    "behind": ("behind it", "#6a3fd0"),
    "missing": ("seen, but no surface", "#d01030"),
}
"""Where a surface is not what was seen: how that is called, and its colour."""
MAX_SIDE = 2000
"""Pixels of an image that is drawn."""
DPI = 80
PANEL, TITLE, HEAD = 5.0, 0.35, 0.9
"""Inches: the width of a panel, what its title and the figure's take."""
EDGE, FLATTEST = 0.06, 0.6
"""Of the object's size, what is left free around it; and the least that a panel is high or wide, of its other side."""
STUB = 0.15
"""Of the object's size, half of a joint's axis at least: that of scissors is no longer than they are thick."""
MAX_DRAWN = 6000
"""Points of a cloud that are drawn at most."""


def reading(turns: bool) -> tuple[float, str]:
    """How a person reads a joint's state: radians or metres of one unit, and what stands behind the number."""
    return (math.radians(1), "°") if turns else (0.01, " cm")


def part_colours(parts: np.ndarray | int) -> np.ndarray:
    """(..., 3) colours of parts by their number, the same in every picture and file; grey below zero, of what is
    none."""
    number, colours = np.asarray(parts, dtype=int), len(PART_COLOURS) - 1
    own = PART_COLOURS[number % colours] * DARKER ** (number // colours)[..., None]
    return np.where(number[..., None] < 0, PART_COLOURS[-1], own)


def figure(observation: Observation, estimate: Estimate, truth: ObjectPose | None = None, title: str = "") -> Figure:
    """Six panels: depth, what was seen (parts, keypoints, axes), the cloud from the side, and the estimated object
    as it is, held against what was seen, and at both ends of its joints' travel. With ``truth`` the true axes are
    dotted."""
    observation = _for_picture(observation)
    camera = observation.camera or camera_around(observation.points)
    model = estimate.object_model()
    poses = np.array([(joint.state, *joint.limits) for joint in estimate.joints]).T
    places = [carry(estimate.T_camera_base, np.concatenate(model.posed_vertices(states))) for states in poses]
    windows = [around(camera, points) for points in ((observation.points, estimate.keypoints), places)]
    heights = [PANEL * (bottom - top) / (right - left) + TITLE for left, right, top, bottom in windows]
    fig, grid = blank_panels(2, 3, (3 * PANEL, sum(heights) + HEAD), heights)
    panels = grid.ravel()
    if observation.depth is None:
        draw_points(panels[0], camera, observation.points, np.array([0.3, 0.3, 0.3]))
        panels[0].set_title("cloud")
    else:
        depth, (near, far) = np.where(observation.depth > 0, observation.depth, np.nan), observation.depth_range
        panels[0].imshow(depth, cmap="viridis_r", vmin=near, vmax=far + 1e-6)
        panels[0].set_title("depth")

    if observation.color is not None:
        panels[1].imshow(observation.color)
    draw_points(panels[1], camera, observation.points, part_colours(labels_of(estimate, observation)))
    draw_keypoints(panels[1], camera, estimate)
    category = estimate.category
    _draw_axes(panels[1], camera, axis_segments(category, estimate.placed, estimate.keypoints))
    if truth is not None:
        _draw_axes(panels[1], camera, axis_segments(category, truth, estimate.keypoints), "black", ":")
    panels[1].set_title("parts, keypoints, joint axes" + (" (true: dotted)" if truth is not None else ""))

    _draw_from_side(panels[2], observation, estimate)
    panels[2].set_title("cloud and estimated object from the side")

    _draw_surface(panels[3], camera, observation, estimate)
    wide, beyond = _widened(camera, windows[1])
    extent = (-beyond - 0.5, camera.width + beyond - 0.5, camera.height + beyond - 0.5, -beyond - 0.5)
    for panel, name, states in zip(panels[4:], ("lower", "upper"), poses[1:], strict=True):
        panel.imshow(shaded(render(model, states, estimate.T_camera_base, wide)), extent=extent)
        panel.set_title(f"joints at {name} limit")
        placed = model.placed(states, estimate.T_camera_base)
        T_keypoint = placed.T_camera_part[list(category.part_of_keypoint)]
        moved = carry_each(T_keypoint, estimate.canonical_keypoints)
        _draw_axes(panel, camera, axis_segments(category, placed, moved))
    for panel, (left, right, top, bottom) in zip(np.delete(panels, 2), np.repeat(windows, (2, 3), 0), strict=True):
        panel.set(xlim=(left, right), ylim=(bottom, top), aspect="equal")
    states = ", ".join(map(str, estimate.joints))
    fig.suptitle("\n".join(filter(None, [title, states, how_sure(estimate)])))
    lay_out(fig)
    return fig


class Picture(Figure):
    """A figure that notebooks display, pyplot or not."""

    def _repr_png_(self) -> bytes:
        drawn, stored = io.BytesIO(), io.BytesIO()
        with _any_script():
            self.savefig(drawn, format="png", dpi=DPI)
        Image.open(drawn).convert("RGB").quantize(128).save(stored, "PNG", optimize=True)  # notebooks keep it
        return stored.getvalue()


def blank_panels(
    rows: int, columns: int, size: tuple[float, float], heights: Sequence[float] | None = None
) -> tuple[Figure, np.ndarray]:
    """A white figure of ``size`` inches and its panels (rows, columns), without axes; ``heights`` of the rows."""
    fig = Picture(figsize=size, facecolor="white")
    panels = fig.subplots(rows, columns, squeeze=False, height_ratios=heights)
    for panel in panels.flat:
        panel.set(xticks=[], yticks=[])  # which would be made, though nobody sees them
        panel.set_axis_off()
    return fig, panels


def show(observation: Observation, estimate: Estimate, path: str | Path | None = None) -> Figure:
    """Draw an estimate; write it to ``path`` (PNG) where one is given, and return the figure (notebooks display it).
    Raises InputError where an estimate comes first, and for a path that is no picture's or cannot be written."""
    if isinstance(observation, Estimate):
        raise InputError("show: was given the estimate first; give omad.show(observation, estimate)")
    fig = figure(observation, estimate)
    if path is not None:
        save(fig, path)
    return fig


def save(fig: Figure, path: str | Path) -> None:
    """Write a PNG, or what the name's extension says. Raises InputError for one of no picture."""
    _plain_texts(fig)
    kind = Path(path).suffix[1:].lower() or "png"  # without, Matplotlib would choose another name
    if kind not in fig.canvas.get_supported_filetypes():
        raise InputError(f"{path}: no picture is written as .{kind}; give a name that ends in .png, .pdf or .svg")
    with _any_script():
        write_atomic(path, lambda temporary: fig.savefig(temporary, dpi=DPI, format=kind))


def lay_out(fig: Figure, rect: tuple[float, float, float, float] = (0, 0, 1, 1)) -> None:
    """Its texts as they stand, and its panels side by side within ``rect``."""
    _plain_texts(fig)
    with _any_script():
        fig.tight_layout(rect=rect)
    fig.set_layout_engine(None)  # or it would be laid out, drawn in full for that, once more where it is saved


@contextmanager
def _any_script() -> Iterator[None]:
    """Letters that the font lacks are drawn as boxes, and no warning tells of each."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph", UserWarning)
        yield


def _plain_texts(fig: Figure) -> None:
    """Names of files and objects are no formulas: texts are drawn as they stand."""
    for text in fig.findobj(Text):
        assert isinstance(text, Text)
        text.set_parse_math(False)
        lines = text.get_text().encode("utf-8", "replace").decode().split("\n")
        text.set_text("\n".join(map(as_line, lines)))


def _for_picture(observation: Observation) -> Observation:
    """Of a large image only so many rows and columns as a picture shows."""
    camera = observation.camera
    every = 1 if camera is None else -(-max(camera.width, camera.height) // MAX_SIDE)
    if camera is None or every == 1:
        return observation
    images = {name: getattr(observation, name) for name in ("depth", "mask", "color")}
    thinned = {name: None if image is None else image[::every, ::every] for name, image in images.items()}
    size = -(-camera.width // every), -(-camera.height // every)
    return replace(observation, **thinned, camera=camera.zoomed(1 / every, size=size))


def labels_of(estimate: Estimate, observation: Observation) -> np.ndarray:
    """(N,) part of each of the observation's points; none where the estimate is of other points, or forgot them."""
    labels, count = estimate.part_labels, len(observation.points)
    return labels if len(labels) == count else np.full(count, OUTSIDE)


def how_sure(estimate: Estimate) -> str:
    """The probability of an answer as a person reads it; nothing where it is not known."""
    if estimate.probability is None:
        return ""
    return f"right with probability {chance(estimate.probability)}{', doubtful' if estimate.doubtful else ''}"


def draw_points(panel: Axes, camera: Camera, points: np.ndarray, colours: np.ndarray, size: float = 1.5) -> None:
    """Cloud (N, 3) in the image; one colour or (N, 3)."""
    step = -(-len(points) // MAX_DRAWN)
    kept = colours[::step] if colours.ndim == 2 else colours[None]
    panel.scatter(*camera.project(points[::step]).T, s=size, c=kept, linewidths=0)


def draw_keypoints(panel: Axes, camera: Camera, estimate: Estimate) -> None:
    """Keypoints coloured by their index, so that the same place has the same colour on every object."""
    u, v = camera.project(estimate.keypoints).T
    panel.scatter(u, v, s=42, c=np.arange(len(u)), cmap="hsv", edgecolors="black", linewidths=0.6, zorder=3)


def axis_segments(category: Category, placed: ObjectPose, keypoints: np.ndarray) -> np.ndarray:
    """(J, 2, 3) ends of the joints' axes as they are drawn: as long as the object's ``keypoints`` (M, 3), and where
    they are; a slide's, which has no place of its own, through the part that it moves."""
    part_of, least, segments = np.array(category.part_of_keypoint), STUB * diagonal(box(keypoints)[None]), []
    for joint, (axis, pivot, turns) in enumerate(zip(placed.axes, placed.pivots, category.turning, strict=True)):
        centre = (keypoints if turns else keypoints[part_of == joint + 1]).mean(0)
        half = max(0.6 * np.ptp(keypoints @ axis), least)
        foot = pivot + axis * (axis @ (centre - pivot)) if turns else centre
        segments.append([foot - half * axis, foot + half * axis])
    return np.array(segments)


def _draw_axes(panel: Axes, camera: Camera, segments: np.ndarray, colour: str = "crimson", style: str = "-") -> None:
    for ends in segments:
        panel.plot(*camera.project(ends).T, style, color=colour, linewidth=2.5, zorder=4)


def shaded(rendering: Rendering) -> np.ndarray:
    """(H, W, 3) picture of a rendering: a colour a part, darker where surfaces turn away, white around."""
    image = np.ones((*rendering.depth.shape, 3))
    seen = rendering.labels != NOTHING
    image[seen] = part_colours(rendering.labels[seen]) * (0.35 + 0.65 * rendering.cos_view[seen, None])
    return image


def _draw_surface(panel: Axes, camera: Camera, observation: Observation, estimate: Estimate) -> None:
    """The estimated surface; where it is not what was seen, pixels have the colours of ``DIFFERENCES``."""
    parts = estimate.surface.posed()
    overlay = Overlay.of(parts, observation)
    own = overlay.camera
    panel.imshow(shaded(render_parts(parts, camera)))
    tint = np.zeros((own.height, own.width, 4))
    for name, (_, colour) in DIFFERENCES.items():
        tint[overlay.differences[name]] = matplotlib.colors.to_rgba(colour, 0.8)
    corners = own.backproject(np.array([[-0.5, -0.5], [own.width - 0.5, own.height - 0.5]]), np.ones(2))
    (left, top), (right, bottom) = camera.project(corners)
    panel.imshow(tint, extent=(left, right, bottom, top), interpolation="nearest")
    panel.set_title(f"estimated object: {overlay.agreement.explained:.0%} of the pixels explained")
    names = [Patch(color=colour, label=said) for said, colour in DIFFERENCES.values()]
    panel.legend(handles=names, loc="lower left", fontsize=7, frameon=False)


def _draw_from_side(panel: Axes, observation: Observation, estimate: Estimate) -> None:
    """Cloud and model outlines along the object's own x axis, orthographically: depth errors show here."""
    points, labels = observation.points, labels_of(estimate, observation)
    step = -(-len(points) // MAX_DRAWN)
    T_base_camera = np.linalg.inv(estimate.T_camera_base)
    _, y, z = carry(T_base_camera, points[::step]).T
    panel.scatter(z, y, s=1.5, c=part_colours(labels[::step]), linewidths=0)
    for part, mesh in enumerate(estimate.surface.posed()):
        loops = mesh.carried(T_base_camera).triangles[:, [0, 1, 2, 0]]
        panel.add_collection(
            LineCollection(list(loops[..., [2, 1]]), colors=[0.6 * part_colours(part)], linewidths=0.6)
        )
    panel.autoscale_view()
    panel.set_aspect("equal")


def window(camera: Camera, points: np.ndarray) -> tuple[float, float, float, float]:
    """Image region (left, right, top, bottom) around the object, with room for its open parts."""
    pixels = camera.project(points)
    x, y = box(pixels).sum(0) / 2
    half = 0.85 * np.ptp(pixels, axis=0).max() + 1
    return x - half, x + half, y - half, y + half


def around(camera: Camera, clouds: Sequence[np.ndarray]) -> tuple[float, float, float, float]:
    """Image region (left, right, top, bottom) that all points of clouds (N, 3) just fit into, neither very flat nor
    very high."""
    low, high = box(np.concatenate([camera.project(points) for points in clouds]))
    middle, half = (low + high) / 2, (0.5 + EDGE) * (high - low) + 1
    half = np.maximum(half, FLATTEST * half[::-1])
    return middle[0] - half[0], middle[0] + half[0], middle[1] - half[1], middle[1] + half[1]


def _widened(camera: Camera, window: tuple[float, float, float, float]) -> tuple[Camera, int]:
    """A camera that sees all of a region (left, right, top, bottom), and the pixels that it has more on each side:
    half ``MAX_SIDE`` at most, as a point right before the lens makes the region boundless."""
    left, right, top, bottom = window
    beyond = math.ceil(min(max(0, -left, right - camera.width, -top, bottom - camera.height), MAX_SIDE / 2))
    sides = {"width": camera.width + 2 * beyond, "height": camera.height + 2 * beyond}
    return replace(camera, **sides, cx=camera.cx + beyond, cy=camera.cy + beyond), beyond


def camera_around(points: np.ndarray) -> Camera:
    """A camera for a bare cloud: it only serves to draw."""
    widest = float(np.abs(points[:, :2] / np.maximum(points[:, 2:], NEAREST)).max())
    scale = min(STANDARD_CAMERA.fx, 0.45 * STANDARD_CAMERA.height / max(widest, 1e-6))
    return replace(STANDARD_CAMERA, fx=scale, fy=scale)
