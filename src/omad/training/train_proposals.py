"""Train the network that proposes categories, on views of objects of all of them and of strangers to all."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import torch
from torch import Tensor
from torch.nn.functional import cross_entropy

from omad.common.arrays import digest_of
from omad.data.clutter.settings import Clutter
from omad.data.mesh_bank import MeshBank
from omad.data.procedural.strangers import strangers
from omad.data.training_views import ViewSettings, draw_views
from omad.geometry.transforms import MIRROR_X
from omad.model.omadnet import OmadNet
from omad.model.proposals.network import ProposalNet
from omad.objects.category import Category
from omad.objects.model import ObjectModel

from .loop import Schedule, train
from .train_net import ViewTraining

STRANGERS = 0.2
"""Share of the views that show objects of none of the categories."""


@dataclass(frozen=True)
class ProposalTraining(ViewTraining):
    """Settings of its training."""

    schedule: Schedule = Schedule(steps=5000, batch=64, learning_rate=2e-3)
    views: ViewSettings = ViewSettings(clutter=Clutter(clean=0.5, resized=0.05))
    group: int = 4
    """Views of one category, drawn together; the others of a batch are of others. The last ones may be fewer."""
    strangers: int = 1500
    """How many there are."""


@dataclass(frozen=True)
class _Kind:
    """Objects of one kind, to be told from others."""

    category: Category
    bank: MeshBank
    answer: int
    share: float
    """Of the views."""

    def views(self, count: int, settings: ViewSettings, generator: torch.Generator) -> Tensor:
        """(count, n, 3) metres, camera frame; those that may be of either hand are."""
        points = draw_views(self.bank, self.category, count, settings, generator).points * self.category.metres_per_unit
        if not self.category.either_hand:
            return points
        other = torch.rand(count, 1, 1, device=points.device, generator=generator) < 0.5
        return torch.where(other, points * points.new_tensor(MIRROR_X), points)


def train_proposals(
    models: Sequence[Sequence[ObjectModel]],
    categories: Sequence[Category],
    folder: Path,
    settings: ProposalTraining,
    device: torch.device | str = "cpu",
    features: OmadNet | None = None,
    initial: ProposalNet | None = None,
) -> ProposalNet:
    """Learn to tell the ``categories``, whose objects are ``models``, and things of none of them; with the backbone of
    ``features`` to start from where given, or with all of ``initial``, which may know other categories. Returns the
    averaged network; ``folder`` as of ``train``."""
    torch.manual_seed(settings.schedule.seed)
    kinds = _kinds(models, categories, settings, device)
    net = ProposalNet([category.name for category in categories], settings.backbone)
    if initial is not None:
        net.start_from(initial)
    elif features is not None:
        net.backbone.load_state_dict(features.backbone.state_dict())
    net.to(device)
    shares = torch.tensor([kind.share for kind in kinds], device=device)

    def loss_terms(module: ProposalNet, draw: torch.Generator) -> dict[str, Tensor]:
        group, batch = settings.group, settings.schedule.batch
        sizes = [min(group, batch - first) for first in range(0, batch, group)]
        drawn = torch.multinomial(shares, len(sizes), replacement=True, generator=draw).tolist()
        shown = [(kinds[number], size) for number, size in zip(drawn, sizes, strict=True)]
        with torch.no_grad():
            points = torch.cat([kind.views(size, settings.views, draw) for kind, size in shown])
        answers = torch.tensor([kind.answer for kind, size in shown for _ in range(size)], device=device)
        return {"category": cross_entropy(module(points), answers)}

    config = {"kind": net.kind, "categories": [asdict(one) for one in categories], "settings": asdict(settings)}
    config |= {"surfaces": [digest_of(kind.bank.arrays()) for kind in kinds]}
    for name, begun in {"features": features, "initial": initial}.items():
        config[name] = None if begun is None else digest_of(begun.state_dict())
    return train(net, loss_terms, settings.schedule, folder, config)


def _kinds(
    models: Sequence[Sequence[ObjectModel]],
    categories: Sequence[Category],
    settings: ProposalTraining,
    device: torch.device | str,
) -> list[_Kind]:
    others = strangers(settings.strangers, settings.schedule.seed)
    shares = [(1 - STRANGERS) / len(categories)] * len(categories) + [STRANGERS / len(others)] * len(others)
    seen = [*zip(categories, models, strict=True), *((one.category, one.models) for one in others)]
    kinds = []
    for number, (category, objects) in enumerate(seen):
        bank = MeshBank.of(objects, category).to(device)
        kinds.append(_Kind(category, bank, min(number, len(categories)), shares[number]))
    return kinds
