"""Where a template is, and what of it the camera sees. One object, camera frame, category units."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omad.data.rendering.rasteriser import Rendering, render_parts
from omad.geometry.camera import Camera
from omad.geometry.mesh import Mesh
from omad.geometry.rigid import carry
from omad.objects.pose import ObjectPose

from ..fitting.state import State
from ..prior import OmadPrior
from .template import Template

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Placed:
    """A template at some state."""

    state: State
    """A batch of one, float64."""
    moved: Floats
    """(P,) tangent step that led to it from what was found before."""
    own: Floats
    """(M, 3) ``e``, canonical."""
    pose: ObjectPose
    keypoints: Floats
    """(M, 3) canonical, ``e`` among them."""

    @classmethod
    def at(cls, prior: OmadPrior, state: State, moved: Floats, own: Floats) -> Placed:
        """``prior`` in float64."""
        joints = prior.joints(state.beta)
        pose = ObjectPose.at(prior.tree, joints.axes, joints.pivots, state.joint_states, state.T_camera_base)
        return cls(state, moved, own, pose.rows()[0], prior.keypoints(state.beta)[0].numpy() + own)

    def meshes(self, template: Template) -> list[Mesh]:
        """Each part where it is."""
        return [mesh.carried(T) for mesh, T in zip(template.at(self.keypoints), self.pose.T_camera_part, strict=True)]


@dataclass(frozen=True)
class VisibleSurface:
    """Samples of a placed template that the camera sees."""

    points: Floats
    """(S, 3)."""
    normals: Floats
    """(S, 3)."""
    parts: np.ndarray
    """(S,)."""
    which: np.ndarray
    """(S,) which of its part's samples each is."""

    @classmethod
    def of(cls, placed: Placed, template: Template, around: Floats, pixels: int, slack: float) -> VisibleSurface:
        """Samples nearer than ``slack`` behind what a picture, ``pixels`` across, shows there."""
        picture, camera = _picture(placed.meshes(template), around, pixels)
        found = []
        for number, (part, T) in enumerate(zip(template.parts, placed.pose.T_camera_part, strict=True)):
            points = carry(T, part.samples.at(placed.keypoints[part.keypoints]))
            normals = part.normals @ T[:3, :3].T
            column, row = np.rint(camera.project(points)).astype(int).T
            depth = picture.depth[row.clip(0, camera.height - 1), column.clip(0, camera.width - 1)]
            seen = ((normals * points).sum(1) < 0) & ((depth == 0) | (points[:, 2] < depth + slack))
            which = np.flatnonzero(seen)
            found.append((points[which], normals[which], np.full(len(which), number), which))
        return cls(*map(np.concatenate, zip(*found, strict=True)))


def _picture(meshes: list[Mesh], around: Floats, pixels: int) -> tuple[Rendering, Camera]:
    """What is seen of meshes, with a camera that sees all of them and the points ``around`` (N, 3)."""
    points = np.concatenate([*(mesh.vertices for mesh in meshes), around])
    points = points[points[:, 2] > 0]
    camera = Camera.around(points[:, :2] / points[:, 2:], pixels)
    return render_parts(meshes, camera), camera
