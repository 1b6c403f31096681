"""``omad train proposals``: the network that proposes categories."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from tyro.conf import OmitArgPrefixes

import omad
from omad.common.errors import InputError
from omad.common.files import check_folder
from omad.common.lazy import lazy_imports

from ..answer import Answer
from ..options import Device, Json, check_positive, generable
from .schedule import ScheduleOptions

with lazy_imports():
    from omad.common.runtime import pick_device
    from omad.data.source import load_models
    from omad.model.backbones import BackboneConfig, get_backbone
    from omad.model.checkpoint import find_weights, load, save
    from omad.model.omadnet import OmadNet
    from omad.model.proposals import network
    from omad.training.train_proposals import ProposalTraining, train_proposals


@dataclass(frozen=True, kw_only=True)
class TrainProposals:
    """Train the network that proposes categories, on views of their procedural objects and of things of none of them,
    so that few are fitted where many are possible. A category that it does not know is always fitted."""

    output: Path
    """Folder for the checkpoint, the state to resume from, and the metrics. The same command resumes."""
    categories: tuple[str, ...] = ()
    """Default: all that can be generated."""
    objects: int = 400
    """Procedural objects a category."""
    strangers: int = 1500
    """Things of none of them."""
    features: str = "laptop"
    """OMADNet checkpoint, or a category with weights, whose knowledge of clouds it begins with; nothing: with none."""
    initial: str | None = None
    """Checkpoint to start from in place of that, or shipped: also one that knows other categories, where some are
    added, say."""
    size: str | None = None
    """Of the backbone, as of train net; default: of the checkpoint that it starts from, or slim."""
    schedule: OmitArgPrefixes[ScheduleOptions] = ScheduleOptions()
    device: Device = "auto"
    json: Json = False

    def run(self) -> Answer:
        check_positive(objects=self.objects, strangers=self.strangers)
        check_folder(self.output)
        names = generable(self.categories)
        preset, (begun, backbone) = ProposalTraining(), self._begun()
        schedule = self.schedule.of(preset.schedule)
        views = replace(preset.views, points=backbone.points)
        settings = replace(preset, schedule=schedule, strangers=self.strangers, backbone=backbone, views=views)
        device = pick_device(self.device)
        categories = [omad.get_category(name) for name in names]
        models = [load_models("procedural", one, self.objects, "train", 0).models for one in categories]
        net = train_proposals(models, categories, self.output, settings, device, **begun)
        made_of = {name: getattr(self, name) for name in ("objects", "strangers", "features", "initial")}
        save(net, self.output, made_of | {"schedule": asdict(schedule), "version": omad.__version__})
        return Answer({"checkpoint": str(self.output), "categories": list(names)})

    def _begun(self) -> tuple[dict[str, Any], BackboneConfig]:
        """What it begins with, as ``train_proposals`` takes it, and the backbone."""
        found, start = dict[str, Any](), None
        if self.initial is not None:
            folder = network.WEIGHTS if self.initial == "shipped" else Path(self.initial)
            found["initial"] = load(network.ProposalNet, folder)
            start = found["initial"].backbone.config
        elif self.features != "nothing":
            found["features"] = load(OmadNet, find_weights(self.features))
            start = found["features"].backbone.config
        backbone = get_backbone(self.size, start)
        for name, net in found.items():
            if not backbone.takes_weights_of(net.backbone.config):
                raise InputError(f"--{name} {getattr(self, name)}: has no weights for such a size; change --size")
        return found, backbone
