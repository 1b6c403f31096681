"""Rotations, rigid transforms, lines and boxes, batched over leading dimensions. Quaternions are (w, x, y, z),
rotations follow the right-hand rule, ``T_a_b`` is a 4x4 matrix that takes coordinates in frame b to those in a."""

import math

import torch
from torch import Tensor

MIRROR_X = (-1.0, 1.0, 1.0)
"""Reflection of canonical space in the plane x = 0."""


def skew(v: Tensor) -> Tensor:
    """Cross-product matrix: ``skew(v) @ p == v x p``. (..., 3) -> (..., 3, 3)."""
    x, y, z = v.unbind(-1)
    zero = torch.zeros_like(x)
    return torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).unflatten(-1, (3, 3))


def axis_angle_to_matrix(axis: Tensor, angle: Tensor) -> Tensor:
    """Rodrigues' formula for a unit ``axis`` (..., 3) and ``angle`` (...) in radians -> (..., 3, 3)."""
    k = skew(axis)
    sin, cos = angle.sin()[..., None, None], angle.cos()[..., None, None]
    eye = torch.eye(3, dtype=axis.dtype, device=axis.device)
    return eye + sin * k + (1 - cos) * (k @ k)


def so3_exp(omega: Tensor) -> Tensor:
    """Rotation vector (..., 3) in radians -> rotation matrix (..., 3, 3); smooth at zero."""
    squared = omega.square().sum(-1)
    small = squared < 1e-8
    safe = torch.where(small, torch.ones_like(squared), squared)
    angle = safe.sqrt()
    a = torch.where(small, 1 - squared / 6, angle.sin() / angle)
    b = torch.where(small, 0.5 - squared / 24, (1 - angle.cos()) / safe)
    k = skew(omega)
    eye = torch.eye(3, dtype=omega.dtype, device=omega.device)
    return eye + a[..., None, None] * k + b[..., None, None] * (k @ k)


def quaternion_to_matrix(q: Tensor) -> Tensor:
    """Quaternion (..., 4), normalised here -> rotation matrix (..., 3, 3)."""
    w, x, y, z = torch.nn.functional.normalize(q, dim=-1).unbind(-1)
    rows = [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return torch.stack(rows, -1).unflatten(-1, (3, 3))


def matrix_to_quaternion(rotation: Tensor) -> Tensor:
    """Rotation matrix (..., 3, 3) -> unit quaternion (..., 4) with w >= 0. The four products q_i q are read off the
    matrix and the best conditioned one is kept (Shepperd, "Quaternion from rotation matrix", 1978)."""
    xx, b, c, d, yy, f, g, h, zz = rotation.flatten(-2).unbind(-1)
    wx, wy, wz, xy, xz, yz = h - f, c - g, d - b, b + d, c + g, f + h
    rows = [
        1 + xx + yy + zz, wx, wy, wz,
        wx, 1 + xx - yy - zz, xy, xz,
        wy, xy, 1 - xx + yy - zz, yz,
        wz, xz, yz, 1 - xx - yy + zz,
    ]  # fmt: skip
    candidates = torch.stack(rows, -1).unflatten(-1, (4, 4))
    best = candidates.diagonal(dim1=-2, dim2=-1).argmax(-1)
    q = torch.take_along_dim(candidates, best[..., None, None], dim=-2).squeeze(-2)
    q = torch.nn.functional.normalize(q, dim=-1)
    return torch.where(q[..., :1] < 0, -q, q)


def make_transform(rotation: Tensor, translation: Tensor) -> Tensor:
    """Rotation (..., 3, 3) and translation (..., 3) -> 4x4 transform (..., 4, 4)."""
    top = torch.cat([rotation, translation[..., None]], -1)
    bottom = torch.zeros_like(top[..., :1, :])
    bottom[..., 0, 3] = 1
    return torch.cat([top, bottom], -2)


def quarter_turns() -> Tensor:
    """(9, 4, 4) float32 quarter, half and three-quarter turns about each axis of a frame."""
    omega = torch.cat([torch.eye(3, dtype=torch.float32) * quarters * (math.pi / 2) for quarters in (1, 2, 3)])
    return make_transform(so3_exp(omega), torch.zeros_like(omega))


def invert_transform(transform: Tensor) -> Tensor:
    """Inverse of rigid 4x4 transforms (..., 4, 4)."""
    rotation = transform[..., :3, :3].transpose(-1, -2)
    return make_transform(rotation, -(rotation @ transform[..., :3, 3:]).squeeze(-1))


def transform_points(transform: Tensor, points: Tensor) -> Tensor:
    """Apply (..., 4, 4) to points (..., N, 3)."""
    return points @ transform[..., :3, :3].transpose(-1, -2) + transform[..., None, :3, 3]


def fit_transform(a: Tensor, b: Tensor, weights: Tensor) -> Tensor:
    """The rigid T (B, 4, 4) that brings points ``a`` (B, N, 3) nearest to ``b``: weighted least squares, closed form.
    Kabsch, "A solution for the best rotation to relate two sets of vectors", 1976. ``weights`` (B, N). NaN where a
    point, or all weights, tell nothing."""
    share = (weights / weights.sum(-1, keepdim=True))[..., None]
    mean_a, mean_b = (share * a).sum(-2), (share * b).sum(-2)
    moment = (share * (b - mean_b[..., None, :])).mT @ (a - mean_a[..., None, :])
    told = moment.isfinite().flatten(-2).all(-1)[..., None, None]
    U, _, V = torch.linalg.svd(moment.where(told, torch.zeros_like(moment)))  # which raises for a whole batch
    sign = torch.ones_like(mean_a)
    Q = U @ V
    sign[..., 2] = (torch.linalg.cross(Q[..., 0], Q[..., 1], dim=-1) * Q[..., 2]).sum(-1)  # determinant
    R = U * sign[..., None, :] @ V
    return make_transform(R, mean_b - (R @ mean_a[..., None]).squeeze(-1))


def rotation_angle(a: Tensor, b: Tensor) -> Tensor:
    """Angle in radians of the rotation between ``a`` and ``b`` (..., 3, 3); accurate near 0, and in
    single precision within 1e-3 of pi."""
    return 2 * torch.asin((0.5 * (a - b).flatten(-2).norm(dim=-1) / 2**0.5).clamp(max=1))


def vector_angle(a: Tensor, b: Tensor) -> Tensor:
    """Angle in radians between directed vectors (..., 3); accurate near 0 and pi."""
    return torch.atan2(torch.linalg.cross(a, b, dim=-1).norm(dim=-1), (a * b).sum(-1))


def point_to_line(point: Tensor, axis: Tensor, pivot: Tensor) -> Tensor:
    """Distance of ``point`` (..., 3) from the line through ``pivot`` along unit ``axis``."""
    return torch.linalg.cross(point - pivot, axis, dim=-1).norm(dim=-1)


def line_distance(axis_a: Tensor, pivot_a: Tensor, axis_b: Tensor, pivot_b: Tensor) -> Tensor:
    """Distance between two lines (..., 3); point-to-line where they are within about 0.06 degrees of parallel."""
    normal = torch.linalg.cross(axis_a, axis_b, dim=-1)
    length = normal.norm(dim=-1)
    skew_distance = ((pivot_a - pivot_b) * normal).sum(-1).abs() / length.clamp(min=1e-12)
    return torch.where(length < 1e-3, point_to_line(pivot_a, axis_b, pivot_b), skew_distance)


def bounding_box(points: Tensor) -> tuple[Tensor, Tensor]:
    """Corners (low, high), each (..., 3), of the axis-aligned box of points (..., N, 3)."""
    return points.amin(-2), points.amax(-2)
