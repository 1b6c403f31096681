"""Pictures of estimates."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .camera import STANDARD_CAMERA, Camera
from .estimate import Estimate, JointEstimate
from .files import write_atomic
from .metrics import ObjectPose
from .observation import Observation
from .render import NOTHING, Rendering, render

PART_COLOURS = np.array([[0.35, 0.6, 0.95], [1.0, 0.6, 0.25], [0.45, 0.8, 0.4], [0.85, 0.4, 0.75], [0.6, 0.6, 0.6]])
MAX_DRAWN = 6000
"""Points of a cloud that are drawn at most."""


def figure(observation: Observation, estimate: Estimate, truth: ObjectPose | None = None, title: str = "") -> Figure:
    """Six panels: depth, what was seen (parts, keypoints, axes), the cloud from the side, and the estimated object
    as it is and at both ends of its joints' travel. With ``truth`` the true axes are dashed in white."""
    camera = observation.camera or camera_around(observation.points)
    left, right, top, bottom = window(camera, observation.points)
    fig = Figure(figsize=(15, 9.4), facecolor="white")
    panels = fig.subplots(2, 3).ravel()
    for panel in panels:
        panel.set_axis_off()
    if observation.depth is None:
        draw_points(panels[0], camera, observation.points, np.array([0.3, 0.3, 0.3]))
    else:
        depth = np.where(observation.depth > 0, observation.depth, np.nan)
        near, far = np.percentile(observation.points[:, 2], [1, 99])
        panels[0].imshow(depth, cmap="viridis_r", vmin=near, vmax=far + 1e-6)
    panels[0].set_title("depth" if observation.depth is not None else "cloud")

    draw_points(panels[1], camera, observation.points, PART_COLOURS[estimate.part_labels % len(PART_COLOURS)])
    draw_keypoints(panels[1], camera, estimate)
    for joint in estimate.joints:
        draw_axis(panels[1], camera, joint.axis, joint.pivot, estimate.keypoints, "crimson", "-")
    if truth is not None:
        for axis, pivot in zip(truth.axes, truth.pivots, strict=True):
            draw_axis(panels[1], camera, axis, pivot, estimate.keypoints, "black", ":")
    panels[1].set_title("parts, keypoints, joint axes" + (" (true: dotted)" if truth is not None else ""))

    _draw_from_side(panels[2], observation.points, estimate)
    panels[2].set_title("cloud and estimated object from the side")

    model = estimate.object_model()
    limits = np.array([joint.limits for joint in estimate.joints])
    poses = {"estimated object": estimate.joint_states, "joints at lower limit": limits[:, 0]}
    poses["joints at upper limit"] = limits[:, 1]
    for panel, (name, states) in zip(panels[3:], poses.items(), strict=True):
        panel.imshow(shaded(render(model, states, estimate.T_camera_base, camera)))
        panel.set_title(name)
        for joint in estimate.joints:
            draw_axis(panel, camera, joint.axis, joint.pivot, estimate.keypoints, "crimson", "-")
    for panel in (panels[0], panels[1], *panels[3:]):
        panel.set_xlim(left, right)
        panel.set_ylim(bottom, top)
        panel.set_aspect("equal")
    fig.suptitle("\n".join(filter(None, [title, ", ".join(describe(joint) for joint in estimate.joints)])))
    fig.tight_layout()
    return fig


def show(observation: Observation, estimate: Estimate, path: str | Path | None = None) -> Figure:
    """Draw an estimate; write it to ``path`` (PNG) where one is given, and return the figure (notebooks display it)."""
    fig = figure(observation, estimate)
    if path is not None:
        save(fig, path)
    return fig


def save(fig: Figure, path: str | Path) -> None:
    """Write a PNG."""
    write_atomic(path, lambda temporary: fig.savefig(temporary, dpi=80))


def describe(joint: JointEstimate) -> str:
    """A joint's state as a person reads it."""
    if joint.type == "revolute":
        return f"{joint.name} {np.degrees(joint.state):.1f}° ± {np.degrees(joint.state_std):.1f}°"
    return f"{joint.name} {100 * joint.state:.1f} cm ± {100 * joint.state_std:.1f} cm"


def draw_points(panel: Axes, camera: Camera, points: np.ndarray, colours: np.ndarray) -> None:
    """Cloud (N, 3) in the image; one colour or (N, 3)."""
    step = -(-len(points) // MAX_DRAWN)
    u, v = _project(camera, points[::step])
    panel.scatter(u, v, s=1.5, c=colours[::step] if colours.ndim == 2 else [colours], linewidths=0)


def draw_keypoints(panel: Axes, camera: Camera, estimate: Estimate) -> None:
    """Keypoints coloured by their index, so that the same place has the same colour on every object."""
    u, v = _project(camera, estimate.keypoints)
    panel.scatter(u, v, s=42, c=np.arange(len(u)), cmap="hsv", edgecolors="black", linewidths=0.6, zorder=3)


def draw_axis(
    panel: Axes, camera: Camera, axis: np.ndarray, pivot: np.ndarray | None, around: np.ndarray, colour: str, style: str
) -> None:
    """A joint's axis as a line in the image, as long as the object is wide, centred where the object is."""
    centre = around.mean(0)
    half = 0.6 * np.ptp((around - centre) @ axis)
    foot = centre if pivot is None else pivot + axis * (axis @ (centre - pivot))
    u, v = _project(camera, np.stack([foot - half * axis, foot + half * axis]))
    panel.plot(u, v, style, color=colour, linewidth=2.5, zorder=4)


def shaded(rendering: Rendering) -> np.ndarray:
    """(H, W, 3) picture of a rendering: a colour a part, darker where surfaces turn away, white around."""
    image = np.ones((*rendering.depth.shape, 3))
    seen = rendering.labels != NOTHING
    colour = PART_COLOURS[rendering.labels[seen] % len(PART_COLOURS)]
    image[seen] = colour * (0.35 + 0.65 * rendering.cos_view[seen, None])
    return image


def _draw_from_side(panel: Axes, points: np.ndarray, estimate: Estimate) -> None:
    """Cloud and model outlines along the object's own x axis, orthographically: depth errors show here."""
    canonical = np.linalg.inv(estimate.T_camera_base)
    step = -(-len(points) // MAX_DRAWN)
    inside = points[::step] @ canonical[:3, :3].T + canonical[:3, 3]
    colours = PART_COLOURS[estimate.part_labels[::step] % len(PART_COLOURS)]
    panel.scatter(inside[:, 2], inside[:, 1], s=1.5, c=colours, linewidths=0)
    model = estimate.object_model()
    for mesh, vertices, colour in zip(
        model.parts, model.posed_vertices(estimate.joint_states), PART_COLOURS, strict=False
    ):
        edges = np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]])
        for a, b in np.unique(np.sort(edges, axis=1), axis=0):
            panel.plot(vertices[[a, b], 2], vertices[[a, b], 1], color=0.6 * colour, linewidth=0.6)
    panel.set_aspect("equal")


def _project(camera: Camera, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    z = np.maximum(points[:, 2], 1e-6)
    return camera.fx * points[:, 0] / z + camera.cx, camera.fy * points[:, 1] / z + camera.cy


def window(camera: Camera, points: np.ndarray) -> tuple[float, float, float, float]:
    """Image region (left, right, top, bottom) around the object, with room for its open parts."""
    u, v = _project(camera, points)
    centre = np.array([u.min() + u.max(), v.min() + v.max()]) / 2
    half = 0.85 * max(np.ptp(u), np.ptp(v)) + 1
    return centre[0] - half, centre[0] + half, centre[1] - half, centre[1] + half


def camera_around(points: np.ndarray) -> Camera:
    """A camera for a bare cloud: it only serves to draw."""
    u = np.abs(points[:, :2] / np.maximum(points[:, 2:], 1e-6)).max()
    scale = min(STANDARD_CAMERA.fx, 0.45 * STANDARD_CAMERA.height / max(u, 1e-6))
    return Camera(STANDARD_CAMERA.width, STANDARD_CAMERA.height, scale, scale, STANDARD_CAMERA.cx, STANDARD_CAMERA.cy)
