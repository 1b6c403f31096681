"""A surface against the image that it was rendered into: nothing else than the truth explains it."""

from dataclasses import astuple

import numpy as np
import pytest

from omad.data.procedural import generate
from omad.data.rendering.rasteriser import render
from omad.data.rendering.standard_views import standard_view
from omad.geometry.camera import STANDARD_CAMERA
from omad.model.surfaces.agreement import Overlay
from omad.objects.category_file import get_category
from omad.sensing.observation import Observation

CATEGORY = get_category("laptop")
MODEL = generate(CATEGORY, 0, "test")
VIEW = standard_view(MODEL, CATEGORY, (0, 0))
PARTS = MODEL.posed(VIEW.states, VIEW.T_camera_base)


def wall(depth: np.ndarray, metres: float) -> Observation:
    """The object in front of a wall, or with one across it."""
    behind = np.where(depth > 0, np.minimum(depth, metres), metres).astype(np.float32)
    return Observation.from_depth(behind, STANDARD_CAMERA, depth > 0)


def shifted(metres: float):
    return [part.warped(lambda vertices: vertices * (1 + metres / vertices[:, 2].mean())) for part in PARTS]


@pytest.mark.parametrize(
    "seen", [VIEW.observation(), wall(VIEW.depth, 10.0), Observation.from_points(VIEW.observation().points)]
)
def test_the_truth_explains_all(seen):
    found = Overlay.of(PARTS, seen).agreement
    assert found.explained > 0.97
    assert sum(astuple(found)) == pytest.approx(1)


def test_a_surface_that_is_nearer_stands_in_front_and_one_farther_away_behind():
    seen = wall(VIEW.depth, 10.0)
    size = MODEL.diagonal
    assert Overlay.of(shifted(-0.2 * size), seen).agreement.in_front > 0.9
    assert Overlay.of(shifted(0.2 * size), seen).agreement.behind > 0.9


def test_a_part_left_out_is_missing_and_one_too_many_is_looked_through():
    seen = wall(VIEW.depth, 10.0)
    lone = Overlay.of(PARTS[:1], seen).agreement
    labels = render(MODEL, VIEW.states, VIEW.T_camera_base, STANDARD_CAMERA).labels
    share = np.count_nonzero(labels == 1) / np.count_nonzero(labels < 2)
    assert lone.missing + lone.behind == pytest.approx(share, abs=0.03)
    alone = wall(np.where(labels == 0, VIEW.depth, 0), 10.0)
    assert Overlay.of(PARTS, alone).agreement.in_front == pytest.approx(share, abs=0.03)


def test_points_behind_the_camera_are_in_no_picture():
    points = VIEW.observation().points
    some = Observation.from_points(np.concatenate([points, points[:50] * [1, 1, -0.5]]))
    assert Overlay.of(PARTS, some).agreement.explained > 0.97


def test_what_is_hidden_counts_neither_way():
    depth = VIEW.depth
    columns = np.flatnonzero((depth > 0).any(0))
    hidden = np.zeros_like(depth, dtype=bool)
    hidden[:, : (columns[0] + columns[-1]) // 2] = True
    near = np.where(hidden, np.float32(0.5 * depth[depth > 0].min()), np.where(depth > 0, depth, np.float32(10.0)))
    seen = Observation.from_depth(near, STANDARD_CAMERA, (depth > 0) & ~hidden)
    assert Overlay.of(PARTS, seen).agreement.explained > 0.97
