"""Ablations: variants trained with the same small budget, and settings of one network, all on the same noisy views."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import torch

from ..categories import Category
from ..checkpoint import load_net, load_priornet, save_net, save_priornet, training_record
from ..errors import InputError
from ..objects import SampledObject
from ..priornet import PriorNet
from ..train_net import train_net
from ..train_prior import PriorTraining, train_prior
from ..training import Schedule
from .variants import Trained


def train_variant(
    variant: Trained,
    category: Category,
    models: Sequence[SampledObject],
    folder: Path,
    name: str,
    samples: int,
    seed: int,
    device: torch.device,
    features: Path | None = None,
) -> Path:
    """Train prior and network of one variant under ``folder``: the network on ``samples`` views, the prior on twice as
    many clouds. ``features``: the checkpoint of an OMADNet whose backbone the network starts from. What is finished is
    not done again, what is half done goes on. Returns the network's checkpoint. Raises InputError where what is
    finished had another budget or start."""
    checkpoint = checkpoint_of(folder, name)
    schedule = _short(variant.training.schedule, samples, seed)
    start = training_record(features) if features else None
    if (checkpoint / "config.json").is_file():
        _check_same(checkpoint, schedule, start)
        return checkpoint
    own = variant.category(category)
    priornet = _prior(variant, own, models, folder, 2 * samples, seed, device)
    training = replace(variant.training, schedule=schedule)
    backbone = load_net(features) if features else None
    net = train_net(models, own, priornet, checkpoint, training, device, features=backbone)
    save_net(net, checkpoint, _record(schedule) | {"features": start})
    return checkpoint


def _check_same(checkpoint: Path, schedule: Schedule, start: dict[str, Any] | None) -> None:
    record = training_record(checkpoint)
    trained, wanted = (s["steps"] * s["batch"] for s in (record["schedule"], asdict(schedule)))
    if trained != wanted:
        raise InputError(f"{checkpoint}: was trained on {trained} views, not on {wanted}; give another --output")
    if record.get("features") != start:
        raise InputError(f"{checkpoint}: was trained from another start; give the same --features or another --output")


def checkpoint_of(folder: Path, name: str) -> Path:
    """Where a variant's network is."""
    return folder / name.replace(" ", "-")


def _prior(
    variant: Trained,
    category: Category,
    models: Sequence[SampledObject],
    folder: Path,
    samples: int,
    seed: int,
    device: torch.device,
) -> PriorNet:
    home = folder / variant.prior
    if not (home / "config.json").is_file():
        schedule = _short(PriorTraining().schedule, samples, seed)
        net = train_prior(models, category, home, PriorTraining(schedule=schedule), device)
        save_priornet(net, home, _record(schedule))
    return load_priornet(home)


def _short(schedule: Schedule, samples: int, seed: int) -> Schedule:
    """A training on so many samples; the average of the weights forgets faster than in a long one."""
    return replace(schedule, steps=max(samples // schedule.batch, 1), seed=seed, average=0.99)


def _record(schedule: Schedule) -> dict[str, Any]:
    return {"source": "procedural", "schedule": asdict(schedule), "purpose": "ablation"}
