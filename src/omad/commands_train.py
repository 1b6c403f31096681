"""The training commands."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

import torch

from . import __version__
from .ancsh.training import AncshTraining, train_ancsh
from .categories import Category
from .checkpoint import (
    find_weights,
    load_net,
    load_priornet,
    save_ancsh,
    save_net,
    save_priornet,
    save_siamese,
    shipped_categories,
    training_record,
)
from .errors import InputError
from .objects import SampledObject
from .omadnet import OmadNet
from .options import BrokenFiles, CategoryName, Device, Json, Result, Seed, check_category, check_positive
from .pointnet2 import PAPER_SIZE, SLIM, BackboneConfig
from .priornet import PriorNet
from .retrieval.siamese_training import SiameseTraining, train_siamese
from .runtime import keep_freed_memory, pick_device
from .sources.select import load_training_objects
from .spec_file import get_category
from .train_net import NetLossWeights, NetTraining, train_net
from .train_prior import PriorTraining, train_prior
from .training import Schedule


@dataclass(frozen=True)
class _Training:
    """Options that both trainings share."""

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

    def prepare(self, schedule: Schedule) -> tuple[Category, list[SampledObject], Schedule, torch.device]:
        check_positive(objects=self.objects, steps=self.steps, batch=self.batch)
        check_positive(learning_rate=self.learning_rate, max_minutes=self.max_minutes)
        if self.threads < 0:
            raise InputError(f"--threads {self.threads}: must be at least 1, or 0 for PyTorch's choice")
        keep_freed_memory()
        if self.threads:
            torch.set_num_threads(self.threads)
        category = get_category(self.category)
        models = load_training_objects(self.source, category, self.objects, 0, self.broken)
        schedule = replace(schedule, seed=self.seed, max_minutes=self.max_minutes)
        if self.steps is not None:
            schedule = replace(schedule, steps=self.steps)
        if self.batch is not None:
            schedule = replace(schedule, batch=self.batch)
        if self.learning_rate is not None:
            schedule = replace(schedule, learning_rate=self.learning_rate)
        return category, models, schedule, pick_device(self.device)

    def record(self, schedule: Schedule) -> dict[str, Any]:
        """What a checkpoint remembers of its training."""
        return {"source": self.source, "objects": self.objects, "schedule": asdict(schedule), "version": __version__}


@dataclass(frozen=True)
class TrainPrior(_Training):
    """Learn a category's prior (shape basis, joint function) from complete clouds, without keypoint labels."""

    def run(self) -> Result:
        category, models, schedule, device = self.prepare(PriorTraining().schedule)
        net = train_prior(models, category, self.output, PriorTraining(schedule=schedule), device)
        save_priornet(net, self.output, self.record(schedule))
        return 0, {"checkpoint": str(self.output)}


@dataclass(frozen=True)
class _NetTraining(_Training):
    """Options that the trainings of networks with OMADNet's backbone share."""

    initial: Path | None = None
    """OMADNet checkpoint to start from: all of it to fine-tune (with the same prior), its backbone for a baseline, that
    then has had OMADNet's training and its own."""
    size: Literal["slim", "paper"] = "slim"
    """slim: fast on a CPU; paper: the paper's PointNet++."""

    def backbone(self) -> BackboneConfig:
        return PAPER_SIZE if self.size == "paper" else SLIM

    def load_initial(self) -> OmadNet | None:
        if self.initial is None:
            return None
        net = load_net(self.initial)
        check_category("--initial", self.initial, net.category, self.category)
        if net.backbone.config != self.backbone():
            raise InputError(f"--initial {self.initial}: is not of the size {self.size}; change --size")
        return net

    def record(self, schedule: Schedule) -> dict[str, Any]:
        start = {"initial": training_record(self.initial)} if self.initial else {}
        return super().record(schedule) | start


@dataclass(frozen=True)
class TrainAncsh(_NetTraining):
    """Train the baseline A-NCSH as OMADNet is trained: same views, backbone and schedule, but no prior."""

    def run(self) -> Result:
        initial = self.load_initial()
        category, models, schedule, device = self.prepare(AncshTraining().schedule)
        settings = AncshTraining(schedule=schedule, backbone=self.backbone())
        net = train_ancsh(models, category, self.output, settings, device, initial)
        save_ancsh(net, self.output, self.record(schedule))
        return 0, {"checkpoint": str(self.output)}


@dataclass(frozen=True)
class TrainSiamese(_NetTraining):
    """Train the Siamese baseline of retrieval: same views, backbone and schedule as OMADNet, but no prior."""

    def run(self) -> Result:
        initial = self.load_initial()
        category, models, schedule, device = self.prepare(SiameseTraining().schedule)
        settings = SiameseTraining(schedule=schedule, backbone=self.backbone())
        net = train_siamese(models, category, self.output, settings, device, initial)
        save_siamese(net, self.output, self.record(schedule))
        return 0, {"checkpoint": str(self.output)}


@dataclass(frozen=True)
class TrainNet(_NetTraining):
    """Train OMADNet on endless views of a category's objects."""

    prior: Path | None = None
    """Checkpoint folder of the prior; default: the shipped one."""
    attention: bool = True
    """no-attention: all votes for a keypoint count alike, for comparison."""
    refinement_loss: float = 0.0
    """Weight of the refined answer's own error, for fine-tuning with --initial (6 is good); from nothing, it only
    disturbs."""

    def run(self) -> Result:
        prior, initial = self._prior(), self.load_initial()
        category, models, schedule, device = self.prepare(NetTraining().schedule)
        weights = NetLossWeights(refinement=self.refinement_loss)
        settings = NetTraining(schedule, self.backbone(), weights=weights, attention=self.attention)
        net = train_net(models, category, prior, self.output, settings, device, initial)
        save_net(net, self.output, self.record(schedule) | {"refinement_loss": self.refinement_loss})
        return 0, {"checkpoint": str(self.output)}

    def _prior(self) -> PriorNet:
        if self.prior is None and get_category(self.category).name not in shipped_categories():
            raise InputError(
                f"{self.category} has no shipped prior: run omad train prior, then give --prior its folder"
            )
        prior = load_priornet(self.prior or find_weights(self.category) / "prior")
        check_category("--prior", self.prior, prior.category, self.category)
        return prior
