"""The coordinates that A-NCSH's network learns: NPCS, NAOCS, and joints seen from every point.

NPCS: a part's rest box, its centre at the origin, its diagonal 1. NAOCS: the whole object at rest, its centre at the
origin, its diagonal 1. So of part k, ``naocs = sizes[k] * npcs + centres[k]``. B views, N points, K parts, J joints.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from omad.data.surface_bank import SurfaceBank
from omad.data.training_views import ViewBatch
from omad.geometry.kinematics import part_transforms
from omad.geometry.transforms import invert_transform
from omad.objects.category import Category

HEAT_RADIUS = 0.2
"""Share of the object's diagonal within which a point says where a hinge's axis is."""


@dataclass(frozen=True)
class Coordinates:
    """What is true of B views."""

    labels: Tensor
    """(B, N) int64 part."""
    npcs: Tensor
    """(B, N, 3)."""
    sizes: Tensor
    """(B, K) diagonal of a part in NAOCS."""
    centres: Tensor
    """(B, K, 3) box centre of a part in NAOCS."""
    heat: Tensor
    """(B, N, J) 1 on a joint's axis, falling to 0 at ``HEAT_RADIUS`` from it."""
    towards: Tensor
    """(B, N, J, 3) unit vector in NAOCS from the point to the nearest point of the axis."""
    axes: Tensor
    """(B, J, 3) unit, directions of the joints in NAOCS."""
    pivots: Tensor
    """(B, J, 3) a point of each axis in NAOCS."""

    @property
    def naocs(self) -> Tensor:
        """(B, N, 3)."""
        return pick(self.sizes, self.labels)[..., None] * self.npcs + pick(self.centres, self.labels)


def pick(values: Tensor, labels: Tensor) -> Tensor:
    """Of values per part (B, K, ...) those of each point's part, ``labels`` (B, N) -> (B, N, ...)."""
    rows = torch.arange(len(labels), device=labels.device)[:, None]
    return values[rows, labels]


def of_own_part(values: Tensor, labels: Tensor) -> Tensor:
    """Of values per point and part (B, N, K, C) those of the point's own part, ``labels`` (B, N) -> (B, N, C)."""
    return values.take_along_dim(labels[..., None, None], 2).squeeze(2)


def linked(labels: Tensor, category: Category) -> Tensor:
    """Whether a point, by its part (B, N), is of one of the two parts that a joint links -> (B, N, J) bool."""
    child = torch.arange(1, len(category.parts), device=labels.device)
    parent = torch.tensor(category.tree.parents, device=labels.device)
    return (labels[..., None] == child) | (labels[..., None] == parent)


def part_boxes(bank: SurfaceBank, num_parts: int) -> Tensor:
    """Rest boxes (N, K, 2, 3) of the parts of a bank's objects; a part without samples has a box of no size."""
    members = [(bank.labels == part)[..., None] for part in range(num_parts)]
    low = torch.stack([torch.where(member, bank.points, torch.inf).amin(1) for member in members], 1)
    high = torch.stack([torch.where(member, bank.points, -torch.inf).amax(1) for member in members], 1)
    boxes = torch.stack([low, high], 2)
    return torch.where(boxes.isfinite(), boxes, 0.0)


def true_coordinates(views: ViewBatch, boxes: Tensor, category: Category) -> Coordinates:
    """What the network is to say of ``views`` of objects with rest boxes ``boxes`` (N, K, 2, 3) before stretching.
    Coordinates are those that bring NPCS exactly onto the points as seen, noise and all."""
    low, high = (boxes[views.indices] * views.scale[:, None, None]).unbind(2)
    diagonal = (high.amax(1) - low.amin(1)).norm(dim=-1)[:, None]  # (B, 1)
    part_diagonal = (high - low).norm(dim=-1).clamp(min=1e-3)
    centre = (low + high) / 2

    G = part_transforms(category.tree, views.axes, views.pivots, views.states, views.T_camera_base)
    back = pick(invert_transform(G), views.labels)
    canonical = (back[..., :3, :3] @ views.points[..., None]).squeeze(-1) + back[..., :3, 3]
    pivots = views.pivots / diagonal[..., None]
    axes, arm = views.axes[:, None], pivots[:, None] - (canonical / diagonal[..., None])[:, :, None]  # (B, N, J, 3)
    offset = arm - (arm * axes).sum(-1, keepdim=True) * axes
    turning = torch.tensor(category.turning, device=offset.device)
    return Coordinates(
        labels=views.labels,
        npcs=(canonical - pick(centre, views.labels)) / pick(part_diagonal, views.labels)[..., None],
        sizes=part_diagonal / diagonal,
        centres=centre / diagonal[..., None],
        heat=(1 - offset.norm(dim=-1) / HEAT_RADIUS).clamp(min=0) * turning,
        towards=torch.nn.functional.normalize(offset, dim=-1),
        axes=views.axes,
        pivots=pivots,
    )
