"""The training commands."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import omad
from omad.common.errors import InputError
from omad.common.lazy import lazy_imports

from .answer import Answer
from .options import BrokenFiles, CategoryName, Device, Json, Seed, check_category, check_positive, use_threads

with lazy_imports():
    from omad.common.runtime import pick_device
    from omad.data.clutter.settings import Clutter
    from omad.data.source import load_objects
    from omad.data.training_views import ViewSettings
    from omad.evaluation.baselines.ancsh.training import AncshTraining, train_ancsh
    from omad.evaluation.baselines.siamese import SiameseTraining, train_siamese
    from omad.model.backbones import BackboneConfig, get_backbone
    from omad.model.checkpoint import Network, find_weights, load, save, shipped_categories, training_record
    from omad.model.omadnet import OmadNet
    from omad.model.priornet import PriorNet
    from omad.training.loop import Schedule
    from omad.training.train_net import NetLossWeights, NetTraining, train_net
    from omad.training.train_prior import PriorTraining, train_prior


@dataclass(frozen=True, kw_only=True)
class _Training:
    """What all trainings share."""

    category: CategoryName
    output: Path
    """Folder for the checkpoint, the state to resume from, and the metrics. The same command resumes."""
    source: str = "procedural"
    """procedural, a folder of URDF / PartNet-Mobility models, or an ArtImage root (its train split)."""
    objects: int = 1000
    """Procedural objects."""
    broken: BrokenFiles = "refuse"
    steps: int | None = None
    """Optimiser steps; default: the preset's."""
    batch: int | None = None
    """Samples a step; default: the preset's."""
    learning_rate: float | None = None
    """Peak learning rate; default: the preset's. Half of it serves for fine-tuning."""
    max_minutes: float | None = None
    """Finish within this time, learning-rate decay and all."""
    seed: Seed = 0
    threads: int = 0
    """CPU threads; 0: PyTorch's choice. One is faster than two where another program computes."""
    device: Device = "auto"
    json: Json = False

    def learn(self, train: Callable[..., Network], preset: Any, **start: Any) -> Answer:
        """Train with the ``preset``, but for what the options say otherwise, and save it. Raises InputError."""
        asked = {"steps": self.steps, "batch": self.batch, "learning_rate": self.learning_rate}
        check_positive(objects=self.objects, max_minutes=self.max_minutes, **asked)
        use_threads(self.threads)
        category, device = omad.get_category(self.category), pick_device(self.device)
        models = load_objects(self.source, category, self.objects, "train", 0, self.broken)
        given = {name: value for name, value in asked.items() if value is not None}
        schedule = replace(preset.schedule, seed=self.seed, max_minutes=self.max_minutes, **given)
        start |= {"folder": self.output, "settings": replace(preset, schedule=schedule), "device": device}
        net = train(models=models, category=category, **start)
        save(net, self.output, self.record(schedule))
        return Answer({"checkpoint": str(self.output)})

    def record(self, schedule: Schedule) -> dict[str, Any]:
        """What a checkpoint remembers of its training."""
        made_of = {"source": self.source, "objects": self.objects}
        return made_of | {"schedule": asdict(schedule), "version": omad.__version__}


@dataclass(frozen=True, kw_only=True)
class TrainPrior(_Training):
    """Learn a category's prior (shape basis, joint function) from complete clouds, without keypoint labels."""

    def run(self) -> Answer:
        return self.learn(train_prior, PriorTraining())


@dataclass(frozen=True, kw_only=True)
class _NetTraining(_Training):
    """What the trainings of networks with OMADNet's backbone share."""

    initial: Path | None = None
    """OMADNet checkpoint to start from: all of it to fine-tune (with the same prior), its backbone for a baseline, that
    then has had OMADNet's training and its own."""
    size: str = "slim"
    """Of the backbone; slim: fast on a CPU; paper: the paper's PointNet++."""

    def backbone(self) -> BackboneConfig:
        return get_backbone(self.size)

    def load_initial(self) -> OmadNet | None:
        if self.initial is None:
            return None
        net = load(OmadNet, self.initial)
        check_category("--initial", self.initial, net.category, self.category)
        if net.backbone.config != self.backbone():
            raise InputError(f"--initial {self.initial}: is not of the size {self.size}; change --size")
        return net

    def record(self, schedule: Schedule) -> dict[str, Any]:
        start = {"initial": training_record(OmadNet, self.initial)} if self.initial else {}
        return super().record(schedule) | start


@dataclass(frozen=True, kw_only=True)
class TrainAncsh(_NetTraining):
    """Train the baseline A-NCSH as OMADNet is trained: same views, backbone and schedule, but no prior."""

    def run(self) -> Answer:
        return self.learn(train_ancsh, AncshTraining(backbone=self.backbone()), initial=self.load_initial())


@dataclass(frozen=True, kw_only=True)
class TrainSiamese(_NetTraining):
    """Train the Siamese baseline of retrieval: same views, backbone and schedule as OMADNet, but no prior."""

    def run(self) -> Answer:
        return self.learn(train_siamese, SiameseTraining(backbone=self.backbone()), initial=self.load_initial())


@dataclass(frozen=True, kw_only=True)
class TrainNet(_NetTraining):
    """Train OMADNet on endless views of a category's objects."""

    prior: Path | None = None
    """Checkpoint folder of the prior; default: the shipped one."""
    attention: bool = True
    """no-attention: all votes for a keypoint count alike, for comparison."""
    refinement_loss: float = 0.0
    """Weight of the refined answer's own error, for fine-tuning with --initial (6 is good); from nothing, it only
    disturbs."""
    clutter: bool = False
    """Views spoilt as the world spoils them: masks too wide or too narrow, wrong depth, things in front, objects cut
    off. The network learns which points are not on the object, and the estimator drops them."""

    def run(self) -> Answer:
        weights = NetLossWeights(refinement=self.refinement_loss)
        views = ViewSettings(clutter=Clutter() if self.clutter else None)
        preset = NetTraining(backbone=self.backbone(), weights=weights, attention=self.attention, views=views)
        return self.learn(train_net, preset, priornet=self._prior(), initial=self.load_initial())

    def record(self, schedule: Schedule) -> dict[str, Any]:
        return super().record(schedule) | {"refinement_loss": self.refinement_loss, "clutter": self.clutter}

    def _prior(self) -> PriorNet:
        if self.prior is None and omad.get_category(self.category).name not in shipped_categories():
            cure = "run omad train prior, then give --prior its folder"
            raise InputError(f"{self.category} has no shipped prior: {cure}")
        prior = load(PriorNet, self.prior or find_weights(self.category) / "prior")
        check_category("--prior", self.prior, prior.category, self.category)
        return prior
