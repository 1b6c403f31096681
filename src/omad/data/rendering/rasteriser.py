"""Exact depth and part labels of a posed object model: a z-buffer over the object's box in the image."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from omad.common.compiled import jit
from omad.geometry.camera import Camera
from omad.geometry.mesh import Mesh, merge_meshes
from omad.objects.model import ObjectModel

NOTHING = 255
"""Label of a pixel that shows no part."""
NEAR = 1e-3
"""Surfaces nearer than this (metres) are cut off."""
SLACK = 1e-9
"""Pixels. Centres this near to an edge belong to the triangles on both sides, so that rounding opens no cracks."""


@dataclass(frozen=True)
class Rendering:
    """What an ideal depth camera sees."""

    depth: np.ndarray
    """(H, W) float32 metres along z, 0 where nothing is seen."""
    labels: np.ndarray
    """(H, W) uint8 part index, NOTHING where nothing is seen."""
    cos_view: np.ndarray
    """(H, W) float32 |cos| of the angle between the surface normal and the viewing ray, 0 where nothing is seen."""


def render(model: ObjectModel, states: np.ndarray, T_camera_base: np.ndarray, camera: Camera) -> Rendering:
    """``model`` at joint states (J,) and pose (4, 4), seen at pixel centres; both sides of a surface are seen."""
    return render_parts(model.posed(states, T_camera_base), camera)


def render_parts(parts: Sequence[Mesh], camera: Camera) -> Rendering:
    """The same of ``parts`` in the camera frame, metres."""
    mesh = merge_meshes(parts)
    labels = np.repeat(np.arange(len(parts), dtype=np.uint8), [len(part.faces) for part in parts])
    return rasterise(mesh.vertices, mesh.faces, labels, camera)


def rasterise(vertices: np.ndarray, faces: np.ndarray, labels: np.ndarray, camera: Camera) -> Rendering:
    """Triangles ``faces`` (F, 3) over camera-frame ``vertices`` (V, 3) in metres, with part ``labels`` (F,)."""
    depth = np.zeros((camera.height, camera.width), dtype=np.float32)
    rendering = Rendering(depth, np.full_like(depth, NOTHING, dtype=np.uint8), np.zeros_like(depth))
    vertices = np.ascontiguousarray(vertices, dtype=np.float64)
    if (vertices[:, 2] <= NEAR).any():
        triangles, labels = _clip_near(vertices[faces], labels)
        vertices, faces = triangles.reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3)
    if not len(faces):
        return rendering
    pixels, limit = camera.project(vertices), np.array([camera.width, camera.height])
    low = np.clip(np.ceil(pixels.min(0) - SLACK), 0, limit).astype(np.int64)
    high = np.clip(np.floor(pixels.max(0) + SLACK) + 1, low, limit).astype(np.int64)
    inverse = np.zeros((high[1] - low[1], high[0] - low[0]))
    nearest = np.full(inverse.shape, -1, dtype=np.int32)
    intrinsics = (camera.fx, camera.fy, camera.cx - low[0], camera.cy - low[1])
    faces = np.ascontiguousarray(faces, dtype=np.int64)
    _fill(vertices, pixels - low, faces, *intrinsics, inverse, nearest)
    box = slice(low[1], high[1]), slice(low[0], high[0])
    into = rendering.depth[box], rendering.labels[box], rendering.cos_view[box]
    _shade(vertices, faces, np.ascontiguousarray(labels, dtype=np.uint8), *intrinsics, inverse, nearest, *into)
    return rendering


@jit
def _plane(vertices, faces, f):
    """Unnormalised normal of face ``f`` and the plane's n . p."""
    a, b, c = vertices[faces[f, 0]], vertices[faces[f, 1]], vertices[faces[f, 2]]
    e0, e1, e2 = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    g0, g1, g2 = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    nx, ny, nz = e1 * g2 - e2 * g1, e2 * g0 - e0 * g2, e0 * g1 - e1 * g0
    return nx, ny, nz, nx * a[0] + ny * a[1] + nz * a[2]


@jit
def _fill(vertices, pixels, faces, fx, fy, cx, cy, inverse, nearest):
    """Nearest face of every pixel and its 1/z. On a plane n . p = d, 1/z = n . ray / d is linear in the image."""
    height, width = inverse.shape
    for f in range(faces.shape[0]):
        i0, i1, i2 = faces[f, 0], faces[f, 1], faces[f, 2]
        (x0, y0), (x1, y1) = (pixels[i0, 0], pixels[i0, 1]), (pixels[i1, 0], pixels[i1, 1])
        x2, y2 = pixels[i2, 0], pixels[i2, 1]
        top = max(0, int(np.ceil(min(y0, y1, y2) - SLACK)))
        bottom = min(height - 1, int(np.floor(max(y0, y1, y2) + SLACK)))
        low_x, high_x = max(0.0, min(x0, x1, x2) - SLACK), min(width - 1.0, max(x0, x1, x2) + SLACK)
        if top > bottom or np.ceil(low_x) > high_x:
            continue
        area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
        nx, ny, nz, offset = _plane(vertices, faces, f)
        if area == 0.0 or offset == 0.0:
            continue  # seen edge-on
        if area < 0.0:
            x1, y1, x2, y2 = x2, y2, x1, y1
        # slivers extrapolate wildly, so 1/z stays between its values at the corners
        z0, z1, z2 = vertices[i0, 2], vertices[i1, 2], vertices[i2, 2]
        farthest, closest = 1 / max(z0, z1, z2), 1 / min(z0, z1, z2)
        step = nx / (offset * fx)
        for row in range(top, bottom + 1):
            left, right = low_x, high_x
            for ax, ay, bx, by in ((x0, y0, x1, y1), (x1, y1, x2, y2), (x2, y2, x0, y0)):
                # inside: (bx - ax) (row - ay) - (x - ax) (by - ay) >= 0
                rise = by - ay
                if rise > 0.0:
                    right = min(right, ax + (bx - ax) * (row - ay) / rise + SLACK)
                elif rise < 0.0:
                    left = max(left, ax + (bx - ax) * (row - ay) / rise - SLACK)
            value = (ny * (row - cy) / fy + nz) / offset
            for column in range(int(np.ceil(left)), int(np.floor(right)) + 1):
                nearness = min(max(value + step * (column - cx), farthest), closest)
                if nearness > inverse[row, column]:
                    inverse[row, column] = nearness
                    nearest[row, column] = f


@jit
def _shade(vertices, faces, labels, fx, fy, cx, cy, inverse, nearest, depth, part, cos_view):
    """Depth, label and |cos| of the viewing angle of every pixel that a face covers."""
    for row in range(inverse.shape[0]):
        for column in range(inverse.shape[1]):
            f = nearest[row, column]
            if f < 0:
                continue
            depth[row, column] = 1 / inverse[row, column]
            part[row, column] = labels[f]
            nx, ny, nz, _ = _plane(vertices, faces, f)
            x, y = (column - cx) / fx, (row - cy) / fy
            lengths = (nx * nx + ny * ny + nz * nz) * (x * x + y * y + 1)
            cos_view[row, column] = abs(nx * x + ny * y + nz) / np.sqrt(lengths)


def _clip_near(triangles: np.ndarray, labels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cut triangles (F, 3, 3) at z = NEAR and drop what lies behind; labels follow."""
    inside = triangles[..., 2] > NEAR
    whole = inside.all(1)
    kept, kept_labels = [triangles[whole]], [labels[whole]]
    for index in np.nonzero(inside.any(1) & ~whole)[0]:
        corners = []
        for a, b in zip(triangles[index], np.roll(triangles[index], -1, 0), strict=True):
            if a[2] > NEAR:
                corners.append(a)
            if (a[2] > NEAR) != (b[2] > NEAR):
                corners.append(a + (b - a) * (NEAR - a[2]) / (b[2] - a[2]))
        kept += [np.stack([corners[0], b, c])[None] for b, c in pairwise(corners[1:])]
        kept_labels += [labels[index : index + 1]] * (len(corners) - 2)
    return np.concatenate(kept), np.concatenate(kept_labels)
