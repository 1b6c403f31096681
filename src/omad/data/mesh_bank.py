"""Meshes of many objects, and what of them a depth camera sees: training views through which nothing shines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
import torch
from torch import Tensor

from omad.geometry.camera import Camera
from omad.geometry.mesh import merge_meshes
from omad.objects.category import Category
from omad.objects.model import ObjectModel

from .point_views import CELLS, PERSPECTIVE
from .rendering.rasteriser import Rendering, rasterise
from .surface_bank import SurfaceBank

FINE = 2
"""Pixels across a cell of the picture."""


@dataclass(frozen=True)
class MeshBank(SurfaceBank):
    """N objects by their meshes: the points are corners, S each, where an object has fewer its last one again."""

    faces: tuple[np.ndarray, ...]
    """(F, 3) int32 of each object."""

    @classmethod
    def of(cls, models: Sequence[ObjectModel], category: Category) -> MeshBank:
        """In category units."""
        meshes, unit = [merge_meshes(model.parts) for model in models], category.metres_per_unit
        most = max(len(mesh.vertices) for mesh in meshes)

        def tensor(arrays: Sequence[np.ndarray]) -> Tensor:
            padded = [np.concatenate([a, np.repeat(a[-1:], most - len(a), axis=0)]) for a in arrays]
            return torch.as_tensor(np.stack(padded))

        parts = [np.repeat(np.arange(len(m.parts)), [len(part.vertices) for part in m.parts]) for m in models]
        points = tensor([mesh.vertices / unit for mesh in meshes]).float()
        return cls(
            points=points,
            normals=torch.full_like(points, 3**-0.5),  # a face tells them
            labels=tensor(parts),
            axes=torch.as_tensor(np.stack([m.axes for m in models])).float(),
            pivots=torch.as_tensor(np.stack([m.pivots / unit for m in models])).float(),
            limits=torch.as_tensor(np.stack([m.limits / category.state_units[:, None] for m in models])).float(),
            closed=torch.zeros(len(models), dtype=torch.bool),
            faces=tuple(mesh.faces.astype(np.int32) for mesh in meshes),
        )

    def to(self, device: torch.device | str) -> MeshBank:
        return MeshBank(**vars(super().to(device)), faces=self.faces)

    def arrays(self) -> dict[str, Tensor | np.ndarray]:
        """All its numbers by name."""
        return {f.name: getattr(self, f.name) for f in fields(SurfaceBank)} | {"faces": np.concatenate(self.faces)}

    def seen(
        self, indices: Tensor, points: Tensor, centre: Tensor, radius: Tensor, steepest: Tensor, draw: torch.Generator
    ) -> tuple[Tensor, Tensor, Tensor]:
        """What shows of the objects ``indices`` (B,) whose corners are at ``points`` (B, S, 3), camera frame: a random
        place of every cell of the picture, which lies over the bounding sphere as that of ``visible``, (B, CELLS^2, 3);
        whether a surface is there, at a larger cosine than ``steepest`` (B,); its part. Where none is, a corner is."""
        across, batch = FINE * CELLS, len(indices)
        shift, rank = (
            torch.rand(batch, *size, device=points.device, generator=draw).cpu().numpy()
            for size in ((2,), (across, across))
        )
        corners, middle = points.cpu().numpy(), centre.cpu().numpy()
        focal = across / 2 / (PERSPECTIVE * radius.cpu().numpy() / middle[:, 2])
        origin = across / 2 - shift - focal[:, None] * middle[:, :2] / middle[:, 2:]
        shown = []
        for b, index in enumerate(indices.tolist()):
            f, (cx, cy) = float(focal[b]), origin[b].tolist()
            faces, labels = self.faces[index], self.labels[index].cpu().numpy()
            view = rasterise(corners[b], faces, labels[faces[:, 0]], Camera(across, across, f, f, cx, cy))
            shown.append(_a_place_each(view, rank[b], f, origin[b], float(steepest[b]), corners[b]))
        places, there, parts = (torch.from_numpy(np.stack(each)).to(points.device) for each in zip(*shown, strict=True))
        return places, there, parts


def _a_place_each(
    view: Rendering, rank: np.ndarray, focal: float, origin: np.ndarray, steepest: float, corners: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of one picture what ``seen`` gives; of the pixels of a cell that show something it is the one of highest
    ``rank``."""
    shows = _by_cell((view.depth > 0) & (view.cos_view > steepest))
    cell = np.arange(CELLS**2)
    chosen = (_by_cell(rank) + shows).argmax(1)
    row, column = FINE * (cell // CELLS) + chosen // FINE, FINE * (cell % CELLS) + chosen % FINE
    there, depth = shows[cell, chosen], view.depth[row, column]
    rays = np.column_stack([(np.stack([column, row], 1) - origin) / focal, np.ones(len(cell))])
    places = np.where(there[:, None], rays * depth[:, None], corners[cell % len(corners)]).astype(np.float32)
    return places, there, np.where(there, view.labels[row, column], 0).astype(np.int64)


def _by_cell(image: np.ndarray) -> np.ndarray:
    """(CELLS^2, FINE^2) the pixels of every cell."""
    return image.reshape(CELLS, FINE, CELLS, FINE).swapaxes(1, 2).reshape(CELLS**2, FINE**2)
