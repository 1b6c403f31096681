"""Errors of surfaces against closed forms; the command's JSON."""

import math

import numpy as np
import pytest
import trimesh

from helpers.command_line import LAPTOP, answer
from omad.evaluation.shape import NEAR, surface_errors
from omad.geometry.mesh import Mesh, merge_meshes


def ball(radius: float) -> Mesh:
    made = trimesh.creation.icosphere(5, radius=radius)
    return Mesh(np.asarray(made.vertices, np.float64), np.asarray(made.faces, np.int64))


def test_the_same_surface_has_no_error():
    errors = surface_errors(ball(0.5), ball(0.5))
    assert errors.distance < 1e-3
    assert errors.f_score == errors.iou == 1.0


@pytest.mark.parametrize("more", [0.04, 0.06])
def test_a_larger_ball(more):
    errors = surface_errors(ball(0.5 + more), ball(0.5))
    assert errors.distance == pytest.approx(more, rel=0.03)
    assert errors.f_score == (1.0 if more < NEAR else 0.0)
    assert errors.iou == pytest.approx((0.5 / (0.5 + more)) ** 3, rel=0.02)


def test_what_is_missing_counts_one_way_only():
    two = [ball(0.2).warped(lambda v, x=x: v + [x, 0.0, 0.0]) for x in (0.0, 10.0)]
    errors = surface_errors(two[0], merge_meshes(two))
    assert errors.distance == pytest.approx((0.0 + 0.5 * 9.8) / 2, rel=0.05)  # half of the truth is about 9.8 away
    assert errors.f_score == pytest.approx(2 / 3, rel=0.05)
    assert errors.iou == pytest.approx(0.5, rel=0.1)


def test_a_surface_with_a_hole_has_no_volume():
    errors = surface_errors(Mesh(ball(0.5).vertices, ball(0.5).faces[1:]), ball(0.5))
    assert math.isnan(errors.iou)
    assert errors.distance < 1e-3


def test_the_command_compares_surfaces_with_hulls(capsys):
    found = answer(capsys, "eval", "shape", *LAPTOP, "--objects", "3", "--views", "3")
    assert (found["category"], found["views"], found["failures"]) == ("laptop", 3, 0)
    assert set(found["surface"]["parts"]) == set(found["hull"]["parts"]) == {"base", "screen"}
    surface, hull = (found[kind]["whole"] for kind in ("surface", "hull"))
    assert set(surface) == {"distance", "f_score", "iou"}
    assert surface["distance"]["mean"] < hull["distance"]["mean"]
    assert surface["f_score"]["mean"] > hull["f_score"]["mean"]
    assert len(found["by_object"]) == 3
