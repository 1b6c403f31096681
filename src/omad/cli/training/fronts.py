"""``omad train fronts``: the networks that tell categories, and objects from their mirror images, by their fronts."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from tyro.conf import OmitArgPrefixes

import omad
from omad.common.files import check_folder
from omad.common.lazy import lazy_imports
from omad.common.stderr import tell

from ..answer import Answer
from ..options import Device, Json, check_positive, generable
from .schedule import ScheduleOptions

with lazy_imports():
    from numpy import ndarray
    from numpy.random import default_rng

    from omad.common.arrays import load_arrays, save_arrays
    from omad.common.runtime import pick_device
    from omad.data.source import load_models
    from omad.data.variation import nearly_at_rest
    from omad.model.checkpoint import save, shipped_categories
    from omad.training.loop import Training
    from omad.training.train_fronts import FrontTraining, HandTraining, front_images, train_fronts, train_hands


@dataclass(frozen=True, kw_only=True)
class TrainFronts:
    """Train the network that tells categories by their fronts, as chests of four drawers from those of five, on images
    of their procedural objects; then one that tells objects from their mirror images, where a category's objects may be
    of either hand. What the two do not know is told by all else."""

    output: Path
    """Folder for the images, and for the checkpoint, the state to resume from and the metrics of the one; those of the
    other are in its folder hands. The same command resumes."""
    categories: tuple[str, ...] = ()
    """Default: all that have weights."""
    objects: int = 3000
    """Procedural objects a category."""
    views: int = 3000
    """Of them; each gives two images."""
    schedule: OmitArgPrefixes[ScheduleOptions] = ScheduleOptions()
    device: Device = "auto"
    json: Json = False

    def run(self) -> Answer:
        check_positive(objects=self.objects, views=self.views)
        check_folder(self.output)
        names, device = generable(self.categories or tuple(shipped_categories())), pick_device(self.device)
        front = FrontTraining(self.schedule.of(FrontTraining().schedule))
        hand = HandTraining(self.schedule.of(HandTraining().schedule))
        fronts = {name: self._images(name, shut=False) for name in names}
        save(train_fronts(fronts, self.output, front, device), self.output, self._record(front))
        hands = {name: self._images(name, shut=True) for name in names if omad.get_category(name).either_hand}
        if hands:
            folder = self.output / "hands"
            save(train_hands(hands, folder, hand, device), folder, self._record(hand))
        return Answer({"checkpoint": str(self.output), "categories": list(names), "hands": list(hands)})

    def _record(self, settings: Training) -> dict[str, Any]:
        made_of = {"objects": self.objects, "views": self.views, "version": omad.__version__}
        return made_of | {"schedule": asdict(settings.schedule)}

    def _images(self, name: str, shut: bool) -> ndarray:
        """Of one category, those that an earlier run has made; half of the objects nearly ``shut``, or none."""
        path, seed = self.output / "images" / f"{name}{'-shut' * shut}.npz", self.schedule.seed
        identity = {"objects": self.objects, "views": self.views, "seed": seed, "version": omad.__version__}
        if found := load_arrays(path, identity, "--output"):
            return found["images"]
        tell(f"{name}: images{' of nearly shut ones' * shut}")
        category = omad.get_category(name)
        models = load_models("procedural", category, self.objects, "train", 0).models
        if shut:  # two by two, as every second view is spoilt
            rng = default_rng(seed)
            models = [nearly_at_rest(model, rng) if i % 4 < 2 else model for i, model in enumerate(models)]
        images = front_images(models, category, self.views, seed)
        save_arrays(path, identity, images=images)
        return images
