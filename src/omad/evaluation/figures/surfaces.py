"""Whole objects: what the camera saw, the surface that is estimated of it, the object itself, and its joints moved."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from omad.data.rendering.standard_views import View
from omad.estimation.estimate import Estimate
from omad.objects.model import ObjectModel

from .qualitative import draw_depth
from .scene import crop_around, paint, studio
from .style import Sheet, styled

ASPECT = 0.9
ROWS = ("depth image", "estimate", "the object", "moved and turned")
MOVED = 0.8
"""Of the way from the estimated state to the limit that is farther from it."""


@dataclass(frozen=True)
class Seen:
    """One view, what is estimated of it, and the object that was there."""

    view: View
    estimate: Estimate
    model: ObjectModel


@styled
def draw(columns: Sequence[Seen], note: str = "") -> Figure:
    """A column a view. The last row is seen from elsewhere, with the joints at other states."""
    sheet = Sheet.of(len(ROWS), len(columns), ASPECT)
    for row, name in enumerate(ROWS):
        sheet.label(row, name, ruled=False)
    for index, seen in enumerate(columns):
        view, estimate = seen.view, seen.estimate
        sheet.header(index, estimate.category.name)
        observation, surface = view.observation(), estimate.surface.posed()
        true = seen.model.posed(view.states, view.T_camera_base)
        everything = np.concatenate([observation.points, *(part.vertices for part in (*surface, *true))])
        crop = crop_around(view.camera, everything, ASPECT)
        panels = [sheet.panel(row, index) for row in range(len(ROWS))]
        draw_depth(panels[0], crop, observation)
        paint(panels[1], crop, surface, pale=0.15)
        paint(panels[2], crop, true, pale=0.15)
        whole, states = estimate.object_model(), _moved(estimate)
        T, camera = studio(np.concatenate(whole.posed_vertices(states)), ASPECT)
        paint(panels[3], camera, whole.posed(states, T), pale=0.15)
    sheet.note(note)
    return sheet.figure


def _moved(estimate: Estimate) -> np.ndarray:
    """(J,) joint states far from the estimated ones; every second joint less far."""
    states, (low, high) = estimate.joint_states, np.array([joint.limits for joint in estimate.joints]).T
    far = np.where(states - low > high - states, low, high)
    share = MOVED * np.where(np.arange(len(states)) % 2, 0.6, 1.0)
    return states + share * (far - states)
