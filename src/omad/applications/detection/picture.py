"""One picture of all that was found in a frame."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from omad.data.rendering.rasteriser import render
from omad.estimation.estimate import chance
from omad.geometry.camera import Camera
from omad.output.picture import blank_panels, camera_around, draw_points, lay_out, part_colours, shaded
from omad.sensing.observation import Observation

from .detector import Detection, called

GREY = np.array([0.55, 0.55, 0.55])
LETTER, LINE = 0.0135, 0.045
"""Of a label: shares of the image's width and height."""


def figure(frame: Observation, detections: Sequence[Detection], title: str = "") -> Figure:
    """Two panels: the frame, or what the colour camera saw of it, with each thing in its colour (grey: of no category),
    its number and category; and the estimated objects where they are."""
    camera = frame.camera or camera_around(frame.points)
    fig, grid = blank_panels(1, 2, (15, 6.2))
    seen, estimated = grid.ravel()
    if frame.depth is None:
        draw_points(seen, camera, frame.points, np.array([0.8, 0.8, 0.8]))
    elif frame.color is not None:
        seen.imshow(frame.color)
    else:
        near, far = frame.depth_range
        seen.imshow(np.where(frame.depth > 0, frame.depth, np.nan), cmap="gray_r", vmin=near, vmax=far + 1e-6)
    image, nearest = np.ones((camera.height, camera.width, 3)), np.full((camera.height, camera.width), np.inf)
    labels: list[np.ndarray] = []
    for number, found in enumerate(detections, 1):
        points = found.observation.points
        colour = GREY if found.category is None else part_colours(number)
        draw_points(seen, camera, points, colour)
        name = f"{number} {called(found.likely)} {chance(found.likely_probability)}"
        x, y = _clear(np.median(camera.project(points), axis=0), name, labels, camera)
        seen.text(x, y, name, ha="center", bbox={"facecolor": "white", "alpha": 0.7, "pad": 1.5, "linewidth": 0})
        if found.estimate is not None:
            estimate = found.estimate
            rendering = render(estimate.object_model(), estimate.joint_states, estimate.T_camera_base, camera)
            shown = (rendering.depth > 0) & (rendering.depth < nearest)
            image[shown], nearest[shown] = shaded(rendering)[shown], rendering.depth[shown]
    estimated.imshow(image)
    for panel in grid.ravel():
        panel.set(xlim=(0, camera.width), ylim=(camera.height, 0), aspect="equal")
    seen.set_title("found")
    estimated.set_title("estimated objects")
    fig.suptitle(title)
    lay_out(fig)
    return fig


def _clear(place: np.ndarray, name: str, labels: list[np.ndarray], camera: Camera) -> np.ndarray:
    """(2,) pixels below the ``labels`` (low and high corners) that lie where one called so would: its own is added."""
    half = np.array([len(name) * LETTER * camera.width, LINE * camera.height]) / 2
    for low, high in sorted(labels, key=lambda label: label[0, 1]):
        if ((place + half > low) & (place - half < high)).all():
            place = np.array([place[0], high[1] + half[1]])
    labels.append(np.stack([place - half, place + half]))
    return place
