"""Rotations, transforms and lines, against independent formulas, near their singular points too."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from omad.geometry import transforms as g

ANGLES = [0.0, 1e-12, 1e-8, 1e-5, 1e-4, 0.3, math.pi / 2, 3.0, math.pi - 1e-4, math.pi - 1e-7, math.pi]
components = st.floats(-1, 1, allow_nan=False)
directions = st.tuples(components, components, components).filter(lambda v: np.linalg.norm(v) > 1e-2)


def unit(v) -> torch.Tensor:
    return torch.nn.functional.normalize(torch.tensor(v, dtype=torch.float64), dim=-1)


@pytest.mark.parametrize("batch", [(), (1,), (5,), (2, 3)])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_rotations_are_batched_and_keep_their_type(batch, dtype):
    omega = torch.randn(*batch, 3, dtype=dtype, generator=torch.Generator().manual_seed(0))
    R = g.so3_exp(omega)
    assert R.shape == (*batch, 3, 3)
    assert R.dtype == dtype
    q = g.matrix_to_quaternion(R)
    assert q.shape == (*batch, 4)
    tolerance = 1e-5 if dtype == torch.float32 else 1e-12
    torch.testing.assert_close(g.quaternion_to_matrix(q), R, atol=tolerance, rtol=0)
    torch.testing.assert_close(g.quaternion_to_matrix(-3 * q), R, atol=tolerance, rtol=0)
    identity = torch.eye(3, dtype=dtype).expand(*batch, 3, 3)
    torch.testing.assert_close(R @ R.mT, identity, atol=tolerance, rtol=0)


@pytest.mark.parametrize("angle", ANGLES)
def test_rotations_agree_with_scipy_down_to_zero_and_up_to_half_a_turn(angle):
    for axis in (*np.eye(3), -np.eye(3)[0], [1, 2, -3], [1e-9, 1, 0], [-1, 1, 0]):
        u = unit(axis)
        expected = torch.tensor(Rotation.from_rotvec(angle * u.numpy()).as_matrix())
        torch.testing.assert_close(g.so3_exp(angle * u), expected, atol=1e-12, rtol=0)
        by_axis = g.axis_angle_to_matrix(u, torch.tensor(angle, dtype=torch.float64))
        torch.testing.assert_close(by_axis, expected, atol=1e-12, rtol=0)
        q = g.matrix_to_quaternion(expected)
        assert q[0] >= 0
        torch.testing.assert_close(g.quaternion_to_matrix(q), expected, atol=1e-12, rtol=0)
        eye = torch.eye(3, dtype=torch.float64)
        assert abs(float(g.rotation_angle(expected, eye)) - angle) < 2e-8


@settings(max_examples=60, deadline=None)
@given(directions, directions, st.floats(-math.pi, math.pi))
def test_rotation_turns_by_the_right_hand_rule(axis, vector, angle):
    u, v = unit(axis), torch.tensor(vector, dtype=torch.float64)
    turned = g.axis_angle_to_matrix(u, torch.tensor(angle, dtype=torch.float64)) @ v
    along = u * (u @ v)
    across = v - along
    expected = along + across * math.cos(angle) + torch.linalg.cross(u, across) * math.sin(angle)
    torch.testing.assert_close(turned, expected, atol=1e-12, rtol=0)


def test_exponential_is_differentiable_at_and_around_zero():
    omegas = [torch.zeros(3), torch.full((3,), 1e-6), torch.full((3,), 1e-3), torch.tensor([1.0, -2.0, 0.5])]
    for omega in omegas:
        assert torch.autograd.gradcheck(g.so3_exp, omega.double().requires_grad_())


@pytest.mark.parametrize("angle", [1e-6, 1e-3, 1.0, math.pi - 1e-3, math.pi - 1e-6])
def test_angles_between_vectors_are_accurate_at_both_ends(angle):
    a = torch.tensor([1.0, 0, 0], dtype=torch.float64)
    b = torch.tensor([math.cos(angle), math.sin(angle), 0], dtype=torch.float64)
    assert float(g.vector_angle(a, 3 * b)) == pytest.approx(angle, abs=1e-12)


@settings(max_examples=30, deadline=None)
@given(directions, directions, st.tuples(components, components, components))
def test_line_distance_is_the_shortest_between_any_two_points(axis_a, axis_b, offset):
    a, b = unit(axis_a), unit(axis_b)
    if torch.linalg.cross(a, b).norm() < 0.05:
        return
    p, q = torch.zeros(3, dtype=torch.float64), torch.tensor(offset, dtype=torch.float64)

    def squared(s):
        gap = p.numpy() + s[0] * a.numpy() - q.numpy() - s[1] * b.numpy()
        return gap @ gap, np.array([2 * gap @ a.numpy(), -2 * gap @ b.numpy()])

    shortest = math.sqrt(minimize(squared, np.zeros(2), jac=True, tol=1e-14).fun)
    assert float(g.line_distance(a, p, b, q)) == pytest.approx(shortest, abs=1e-5)


def test_distance_of_parallel_lines_is_point_to_line_and_never_nan():
    x = torch.tensor([1.0, 0, 0], dtype=torch.float64)
    p, q = torch.zeros(3, dtype=torch.float64), torch.tensor([5.0, 3.0, 4.0], dtype=torch.float64)
    for b in (x, -x, unit([1, 1e-9, 0]), unit([1, 0, 1e-5])):
        assert float(g.line_distance(x, p, b, q)) == pytest.approx(5.0, rel=1e-3)
    assert float(g.line_distance(x, p, x, p)) == 0.0


def test_transforms_compose_and_invert():
    generator = torch.Generator().manual_seed(1)
    R = g.so3_exp(torch.randn(4, 3, dtype=torch.float64, generator=generator))
    t, points = (torch.randn(4, n, 3, dtype=torch.float64, generator=generator) for n in (1, 7))
    T = g.make_transform(R, t[:, 0])
    torch.testing.assert_close(T @ g.invert_transform(T), torch.eye(4, dtype=torch.float64).expand(4, 4, 4))
    homogeneous = torch.cat([points, torch.ones_like(points[..., :1])], -1)
    torch.testing.assert_close(g.transform_points(T, points), (homogeneous @ T.mT)[..., :3])


def test_bounding_box_of_a_batch():
    points = torch.tensor([[[0.0, 5, -1], [2, -3, 4]], [[1, 1, 1], [1, 1, 1]]])
    low, high = g.bounding_box(points)
    assert low.tolist() == [[0, -3, -1], [1, 1, 1]]
    assert high.tolist() == [[2, 5, 4], [1, 1, 1]]
