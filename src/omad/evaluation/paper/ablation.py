"""Ablations, all on the same noisy views: variants trained with the same small budget, and settings of one network."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path

import torch

from omad.common.errors import InputError
from omad.data.training_views import ViewSettings
from omad.estimation.estimator import Estimator, EstimatorConfig
from omad.model.checkpoint import is_checkpoint, load, save, training_record
from omad.model.omadnet import OmadNet
from omad.model.priornet import PriorNet
from omad.objects.category import Category
from omad.objects.model import SampledObject
from omad.training.loop import Schedule
from omad.training.train_net import NetTraining, train_net
from omad.training.train_prior import PriorTraining, train_prior

from ..baselines.adam import adam_refinement


@dataclass(frozen=True)
class Trained:
    """A variant that needs a training of its own."""

    keypoints: float = 1.0
    """Times as many on each part."""
    basis: float = 1.0
    """Times as many numbers in beta."""
    training: NetTraining = NetTraining()
    config: EstimatorConfig = field(default_factory=EstimatorConfig)

    def category(self, category: Category) -> Category:
        """The category with as many; keypoints of a part stay even, since some parts are their own mirror."""
        more = self.keypoints
        parts = tuple(replace(p, keypoints=max(2 * round(more * p.keypoints / 2), 2)) for p in category.parts)
        return replace(category, parts=parts, basis_size=max(round(self.basis * category.basis_size), 1))

    @property
    def prior(self) -> str:
        """Variants with the same prior share it."""
        return f"prior-{self.keypoints:g}-{self.basis:g}"


ONE_LOOK = EstimatorConfig(samples=(sum(EstimatorConfig().samples),))
TRAINED = {
    "as it is": Trained(),
    "a third of the keypoints": Trained(keypoints=1 / 3),
    "twice the keypoints": Trained(keypoints=2),
    "a fifth of beta": Trained(basis=0.2),
    "half of beta": Trained(basis=0.5),
    "twice beta": Trained(basis=2),
    "no attention": Trained(training=NetTraining(attention=False)),
    "no noise in training": Trained(training=NetTraining(views=ViewSettings(noise=0.0))),
    "no second look": Trained(training=NetTraining(second_looks=0.0), config=ONE_LOOK),
}
"""By name; the first is what the others are compared with."""

SETTINGS: dict[str, Callable[..., Estimator]] = {
    "as it is": Estimator,
    "one look": partial(Estimator, config=ONE_LOOK),
    "keypoints count alike": partial(Estimator, config=EstimatorConfig(confidence=False)),
    "Adam, as in the paper": partial(Estimator, refine=adam_refinement),
}
"""Estimators of one and the same network: each is called with it and the ``device``."""


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
    checkpoint, home, own = checkpoint_of(folder, name), folder / variant.prior, variant.category(category)
    schedule = _short(variant.training.schedule, samples, seed)
    made_of = {"source": "procedural", "purpose": "ablation", "objects": len(models)}
    start = training_record(OmadNet, features) if features else None
    if is_checkpoint(checkpoint):
        record = training_record(OmadNet, checkpoint)
        trained, wanted = record["schedule"]["steps"] * record["schedule"]["batch"], schedule.steps * schedule.batch
        if trained != wanted:
            raise InputError(f"{checkpoint}: was trained on {trained} views, not on {wanted}; give another --output")
        if record["schedule"]["seed"] != seed or record.get("objects", len(models)) != len(models):
            raise InputError(f"{checkpoint}: was trained with another seed or other objects; give another --output")
        if record.get("features") != start:
            cure = "give the same --features or another --output"
            raise InputError(f"{checkpoint}: was trained from another start; {cure}")
        return checkpoint
    short = PriorTraining(schedule=_short(PriorTraining().schedule, 2 * samples, seed))
    if is_checkpoint(home):
        record = training_record(PriorNet, home)
        if record["schedule"] != asdict(short.schedule) or record.get("objects", len(models)) != len(models):
            raise InputError(f"{home}: was trained on other views or objects; give another --output")
    else:
        save(train_prior(models, own, home, short, device), home, made_of | {"schedule": asdict(short.schedule)})
    training = replace(variant.training, schedule=schedule)
    backbone = load(OmadNet, features) if features else None
    net = train_net(models, own, load(PriorNet, home), checkpoint, training, device, features=backbone)
    save(net, checkpoint, made_of | {"schedule": asdict(schedule), "features": start})
    return checkpoint


def checkpoint_of(folder: Path, name: str) -> Path:
    """Where a variant's network is."""
    return folder / name.replace(" ", "-")


def _short(schedule: Schedule, samples: int, seed: int) -> Schedule:
    """A training on so many samples; the average of the weights forgets faster than in a long one."""
    return replace(schedule, steps=max(samples // schedule.batch, 1), seed=seed, average=0.99)
