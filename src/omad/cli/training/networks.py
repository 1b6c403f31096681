"""A training a command: prior, network, baselines."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

from tyro.conf import OmitArgPrefixes

import omad
from omad.common.errors import InputError
from omad.common.files import check_folder
from omad.common.lazy import lazy_imports

from ..answer import Answer
from ..options import (
    BrokenFiles,
    CategoryName,
    Device,
    Json,
    check_category,
    check_positive,
    load_prior,
    shipped_prior,
)
from .schedule import ScheduleOptions

with lazy_imports():
    from omad.common.runtime import device_name
    from omad.data.clutter.settings import Clutter
    from omad.data.source import load_objects
    from omad.data.training_views import ViewSettings
    from omad.evaluation.baselines.ancsh.net import AncshNet
    from omad.evaluation.baselines.ancsh.training import AncshTraining, train_ancsh
    from omad.evaluation.baselines.siamese import SiameseNet, SiameseTraining, train_siamese
    from omad.model import checkpoint
    from omad.model.backbones import BackboneConfig, get_backbone
    from omad.model.checkpoint import (
        Network,
        category_of,
        find_weights,
        is_checkpoint,
        load,
        meant_weights,
        save,
        training_record,
    )
    from omad.model.omadnet import OmadNet
    from omad.model.priornet import PriorNet
    from omad.training.loop import Schedule
    from omad.training.processes import Processes, start
    from omad.training.train_net import NetLossWeights, NetTraining, train_net
    from omad.training.train_prior import PriorTraining, train_prior


@dataclass(frozen=True)
class SeveralProcesses:
    """Work of several processes on several machines."""

    device: Device = "auto"
    devices: int = 1
    """Processes on each machine, one an accelerator, that share every batch; on the CPU as many as are asked for. The
    same command resumes with another number of them. More than one in all need omad[cluster]."""
    nodes: int = 1
    """Machines; torchrun or SLURM starts the command on all of them."""
    accumulate: int = 1
    """Parts that a process makes its share of a batch in, where memory holds no more at a time."""
    precision: Literal["float32", "bf16"] = "float32"
    """Of the backbone on an accelerator: bf16 takes half the memory, and where it is built for it half the time."""

    def start(self) -> Processes:
        """All of them. Raises InputError."""
        check_positive(devices=self.devices, nodes=self.nodes, accumulate=self.accumulate)
        return start(self.devices, self.nodes, self.accumulate, self.device, self.precision)


@dataclass(frozen=True, kw_only=True)
class _Training:
    """What all trainings share."""

    category: CategoryName
    output: Path
    """Folder for the checkpoint, the state to resume from, and the metrics. The same command resumes."""
    source: str = "procedural"
    """procedural, a generator of your own (.py, which is run), a folder of URDF / PartNet-Mobility models, or an
    ArtImage root (its train split)."""
    objects: int = 1000
    """Procedural objects."""
    variants: int = 300
    """Models of your own, where they are fewer, are varied until there are so many: stretched, with other proportions,
    with parts of each other. 0: train on them alone."""
    broken: BrokenFiles = "refuse"
    schedule: OmitArgPrefixes[ScheduleOptions] = ScheduleOptions()
    several: OmitArgPrefixes[SeveralProcesses] = SeveralProcesses()
    json: Json = False

    def learn(self, network: type[Network], train: Callable[..., Network], preset: Any, **begun: Any) -> Answer:
        """Train a ``network`` with the ``preset``, but for what the options say otherwise, and save it. Raises
        InputError."""
        if self.variants < 0:
            raise InputError(f"--variants: must be 0 or more, got {self.variants}")
        check_positive(objects=self.objects, variants=self.variants or None)
        check_folder(self.output)
        if is_checkpoint(self.output):
            check_category("--output", self.output, category_of(network, self.output), self.category)
            if not (self.output / checkpoint.STATE).is_file():
                cure = "give another --output"
                raise InputError(f"{self.output}: holds finished weights, no training to go on with; {cure}")
        schedule = self.schedule.of(preset.schedule)
        processes = self.several.start()
        with processes.heard():
            category = omad.get_category(self.category)
            models = load_objects(self.source, category, self.objects, "train", 0, self.broken, self.variants)
            begun |= {"folder": self.output, "settings": replace(preset, schedule=schedule), "processes": processes}
            net = train(models=models, category=category, device=processes.device, **begun)
            if processes.first:
                save(net, self.output, self.record(schedule) | {"device": device_name(processes.device)})
        return Answer({"checkpoint": str(self.output)})

    def record(self, schedule: Schedule) -> dict[str, Any]:
        """What a checkpoint remembers of its training."""
        made_of = {"source": self.source, "objects": self.objects, "variants": self.variants}
        return made_of | {"schedule": asdict(schedule), "version": omad.__version__}


@dataclass(frozen=True, kw_only=True)
class TrainPrior(_Training):
    """Learn a category's prior (shape basis, joint function) from complete clouds, without keypoint labels."""

    initial: Path | None = None
    """Prior to fine-tune, on more objects than it was trained on. Its keypoints keep their meaning, so that networks
    trained with it can be fine-tuned with the new one (train net --initial)."""

    def run(self) -> Answer:
        initial = None if self.initial is None else load_prior(self.initial, "cpu")
        if initial is not None:
            check_category("--initial", self.initial, initial.category, self.category)
        return self.learn(PriorNet, train_prior, PriorTraining(), initial=initial)

    def record(self, schedule: Schedule) -> dict[str, Any]:
        return super().record(schedule) | begun_with("initial", self.initial, PriorNet)


@dataclass(frozen=True, kw_only=True)
class _NetTraining(_Training):
    """What the trainings of networks with OMADNet's backbone share."""

    initial: str | None = None
    """OMADNet checkpoint to start from, or a category with weights: all of it to fine-tune (with the same prior); of
    another category, what it knows of clouds; its backbone for a baseline, that then has had its training, too."""
    size: str | None = None
    """Of the backbone; slim: fast on a CPU; fine: slim's weights with twice the points, for objects of many parts; it
    takes twice as long; paper: the paper's PointNet++. Default: of what it starts from, or slim."""

    def backbone(self, start: OmadNet | None = None) -> BackboneConfig:
        return get_backbone(self.size, None if start is None else start.backbone.config)

    def views(self, backbone: BackboneConfig, clutter: Clutter | None = None) -> ViewSettings:
        """Of as many points as the backbone will be shown."""
        return ViewSettings(points=backbone.points, clutter=clutter)

    def load_start(self, option: str, weights: str | None) -> OmadNet | None:
        if weights is None:
            return None
        net = load(OmadNet, meant_weights(option, weights))
        if not self.backbone(net).takes_weights_of(net.backbone.config):
            raise InputError(f"{option} {weights}: is not of the size {self.size}; change --size")
        return net

    def learn_baseline(
        self, network: type[Network], train: Callable[..., Network],
        settings: type[AncshTraining] | type[SiameseTraining],
    ) -> Answer:  # fmt: skip
        start = self.load_start("--initial", self.initial)
        backbone = self.backbone(start)
        return self.learn(network, train, settings(backbone=backbone, views=self.views(backbone)), initial=start)

    def record(self, schedule: Schedule) -> dict[str, Any]:
        return super().record(schedule) | begun_with("initial", self.initial, OmadNet)


def begun_with(name: str, weights: str | Path | None, kind: type[Network]) -> dict[str, Any]:
    """What a checkpoint remembers of the network that its training began with, by the option's name."""
    if weights is None:
        return {}
    folder = find_weights(weights)
    return {name: {"category": category_of(kind, folder).name, **training_record(kind, folder)}}


@dataclass(frozen=True, kw_only=True)
class TrainAncsh(_NetTraining):
    """Train the baseline A-NCSH as OMADNet is trained: same views, backbone and schedule, but no prior."""

    def run(self) -> Answer:
        return self.learn_baseline(AncshNet, train_ancsh, AncshTraining)


@dataclass(frozen=True, kw_only=True)
class TrainSiamese(_NetTraining):
    """Train the Siamese baseline of retrieval: same views, backbone and schedule as OMADNet, but no prior."""

    def run(self) -> Answer:
        return self.learn_baseline(SiameseNet, train_siamese, SiameseTraining)


@dataclass(frozen=True, kw_only=True)
class TrainNet(_NetTraining):
    """Train OMADNet on endless views of a category's objects."""

    prior: Path | None = None
    """Checkpoint folder of the prior; default: the shipped one."""
    features: str | None = None
    """OMADNet checkpoint, or a category with weights, to take over what it knows of clouds from: of any category, and
    with any prior."""
    attention: bool = True
    """no-attention: all votes for a keypoint count alike, for comparison."""
    refinement_loss: float = 0.0
    """Weight of the refined answer's own error, for fine-tuning with --initial (6 is good); from nothing, it only
    disturbs."""
    clutter: bool = False
    """Views spoilt as the world spoils them: masks too wide or too narrow, wrong depth, things in front, objects cut
    off. The network learns which points are not on the object, and the estimator drops them."""

    def run(self) -> Answer:
        if self.features is not None and self.initial is not None:
            raise InputError("--features: does not go with --initial, which takes over all; give one of them")
        if not 0 <= self.refinement_loss < float("inf"):
            raise InputError(f"--refinement-loss: must be 0 or more, got {self.refinement_loss:g}")
        begun = self.load_start("--features", self.features)
        start = self.load_start("--initial", self.initial)
        if start is not None and start.category.name != omad.get_category(self.category).name:
            start, begun = None, start
        if start is not None:
            check_category("--initial", self.initial, start.category, self.category)
        backbone, weights = self.backbone(start or begun), NetLossWeights(refinement=self.refinement_loss)
        views = self.views(backbone, Clutter() if self.clutter else None)
        preset = NetTraining(backbone=backbone, weights=weights, attention=self.attention, views=views)
        return self.learn(OmadNet, train_net, preset, priornet=self._prior(), initial=start, features=begun)

    def record(self, schedule: Schedule) -> dict[str, Any]:
        record = super().record(schedule) | {"refinement_loss": self.refinement_loss, "clutter": self.clutter}
        return record | begun_with("features", self.features, OmadNet)

    def _prior(self) -> PriorNet:
        prior = load(PriorNet, self.prior or shipped_prior(self.category))
        check_category("--prior", self.prior, prior.category, self.category)
        return prior
