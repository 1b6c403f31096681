"""``omad train all``: whatever categories there are, each from nothing to weights that answer."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from omad.common.errors import InputError
from omad.common.files import write_json
from omad.common.lazy import lazy_imports

from ..answer import Answer, table
from ..evaluate import EvalPose
from ..options import Device, Json, Seed, Views, check_positive
from .networks import TrainConfidence, TrainNet, TrainPrior, TrainSurface

with lazy_imports():
    from omad.data import procedural
    from omad.estimation.confidence import model as confidences
    from omad.model.checkpoint import is_checkpoint
    from omad.model.surfaces import bank

PRIOR, FIRST, LAST = 0.08, 0.62, 0.3
"""Of a category's time: for the prior, for the network, and for the network with the refined answer's error."""
RESULTS = "results.json"


@dataclass(frozen=True, kw_only=True)
class TrainAll:
    """Train every category from its procedural objects: the prior, the network from a shared backbone on spoilt views,
    then with the refined answer's error, confidence, surfaces; and measure it. What is done stays, and what was
    interrupted goes on, when the command is given again. Two of it, with other categories, may run side by side."""

    output: Path
    """Folder for a checkpoint folder a category, with the stages that led to it."""
    categories: tuple[str, ...] = ()
    """Default: all that can be generated."""
    minutes: float = 60.0
    """A category's, for prior and network; the rest takes some more."""
    features: str = "laptop"
    """OMADNet checkpoint, or a category with weights, whose knowledge of clouds all begin with; nothing: with none."""
    objects: int = 1000
    """Procedural objects a category."""
    views: int = 200
    """To measure on; ten times as many serve to learn the confidence from."""
    steps: int | None = None
    """At most so many of each training; default: as many as the time allows."""
    batch: int = 64
    """Samples a step of the network's training."""
    seed: Seed = 0
    threads: int = 1
    """CPU threads; 0: PyTorch's choice."""
    device: Device = "auto"
    json: Json = False

    def run(self) -> Answer:
        check_positive(minutes=self.minutes, objects=self.objects, views=self.views, steps=self.steps, batch=self.batch)
        known = procedural.GENERATORS
        names = self.categories or known
        if unknown := [name for name in names if name not in known]:
            raise InputError(f"{unknown[0]}: cannot be generated; choose among {', '.join(known)}")
        return Answer({"folder": str(self.output), "results": [self._one(name) for name in names]}, all_text)

    def _one(self, name: str) -> dict[str, Any]:
        """What is measured of a category, once it is trained."""
        home = self.output / name
        priors, first, results = home / "prior", home / "first", home / RESULTS
        made: dict[str, Any] = {"category": name, "objects": self.objects, "threads": self.threads}
        learning = made | {"device": self.device, "seed": self.seed}
        net = learning | {"prior": priors, "clutter": True, "batch": self.batch, "steps": self.steps or 10**7}
        start = net | {"features": None if self.features == "nothing" else self.features}
        last = net | {"refinement_loss": 6.0, "learning_rate": 1e-3, "initial": str(first)}
        made |= {"weights": home}
        stages = (
            (is_checkpoint(priors), TrainPrior(**learning, output=priors, steps=self.steps, **self._time(PRIOR))),
            (is_checkpoint(first), TrainNet(**start, output=first, **self._time(FIRST))),
            (is_checkpoint(home), TrainNet(**last, output=home, **self._time(LAST))),
            ((home / confidences.FILE).is_file(), TrainConfidence(**made, views=10 * self.views, seed=self.seed)),
            ((home / bank.FILE).is_file(), TrainSurface(**made, views=self.views, device=self.device)),
        )
        for done, stage in stages:
            if not done:
                print(f"{name}: {type(stage).__name__}", file=sys.stderr, flush=True)
                stage.run()
        if not results.is_file():
            data = Views(objects=100, views=self.views, depth_noise="on")
            write_json(results, EvalPose(category=name, weights=home, data=data).run().record, indent=1)
        return json.loads(results.read_text())

    def _time(self, share: float) -> dict[str, Any]:
        return {"max_minutes": share * self.minutes}


def all_text(answer: dict[str, Any]) -> str:
    """A line a category: medians of its refined answers on unseen objects, with noise."""
    rows = [["category", "joint states", "axes", "base rotation", "within 5° 5 %"]]
    for result in answer["results"]:
        errors, unit = result["refined"], result["metres_per_unit"]
        both = zip(errors["joint_state_error_deg"], errors["joint_state_error"], strict=True)
        states = [f"{a['median']:.1f}°" if a else f"{b['median'] / unit:.3f} u" for a, b in both]
        axes = [f"{error['median']:.1f}°" for error in errors["axis_error_deg"]]
        turned = errors["rotation_error_deg"][0]["median"]
        row = [result["category"], ", ".join(states), ", ".join(axes), f"{turned:.1f}°"]
        rows.append([*row, f"{errors['within_5deg_5percent']:.0%}"])
    return "\n".join([table(rows), f"weights: {answer['folder']}/<category>"])
