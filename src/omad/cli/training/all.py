"""``omad train all``: whatever categories there are, each from nothing to weights that answer."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from tyro.conf import OmitArgPrefixes

from omad.common.errors import InputError
from omad.common.files import write_json
from omad.common.lazy import lazy_imports

from ..answer import Answer, table
from ..evaluation.pose import EvalPose
from ..options import Json, Seed, Views, check_positive, generable
from .fitted import TrainConfidence, TrainSurface
from .networks import SeveralProcesses, TrainNet, TrainPrior
from .schedule import ScheduleOptions

with lazy_imports():
    from omad.common.incoming import read_json
    from omad.estimation.confidence import model as confidences
    from omad.evaluation.confidence import fitting
    from omad.model.checkpoint import is_checkpoint, meant_weights
    from omad.model.surfaces import bank
    from omad.training.processes import Processes

PRIOR, FIRST, LAST = 0.08, 0.62, 0.3
"""Of a category's time: for the prior, for the network, and for the network with the refined answer's error."""
RESULTS, OPTIONS = "results.json", "options.json"
MADE_WITH = ("minutes", "features", "objects", "views", "steps", "batch", "seed")
"""Options that change what is made."""
NOTHING = "nothing"
"""In place of the features to begin with."""


@dataclass(frozen=True, kw_only=True)
class TrainAll:
    """Train every category from its procedural objects: the prior, the network from a shared backbone on spoilt views,
    then with the refined answer's error, surfaces, confidence; and measure it. What is done stays, and what was
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
    """To measure on; ten times as many, at least 400, serve to learn the confidence from."""
    steps: int | None = None
    """At most so many of each training; default: as many as the time allows."""
    batch: int = 64
    """Samples a step of the network's training, of all processes together."""
    seed: Seed = 0
    threads: int = 1
    """CPU threads; 0: PyTorch's choice."""
    several: OmitArgPrefixes[SeveralProcesses] = SeveralProcesses()
    json: Json = False

    def run(self) -> Answer:
        check_positive(minutes=self.minutes, objects=self.objects, views=self.views, steps=self.steps, batch=self.batch)
        names = generable(self.categories)
        if self.features != NOTHING:
            meant_weights("--features", self.features)  # rather now than once the prior is learnt
        processes = self.several.start()
        with processes.heard():
            processes.share(self.batch)  # as above
            results = [self._one(name, processes) for name in names]
        return Answer({"folder": str(self.output), "results": results}, all_text)

    def _one(self, name: str, processes: Processes) -> dict[str, Any]:
        """What is measured of a category, once it is trained: its networks by all ``processes``, the rest by one."""
        home = self.output / name
        processes.alone(lambda: self._check_options(home / OPTIONS))
        priors, first, results = home / "prior", home / "first", home / RESULTS
        made: dict[str, Any] = {"category": name, "objects": self.objects}
        device = self.several.device
        long = ScheduleOptions(steps=self.steps, seed=self.seed, threads=self.threads)
        longer = replace(long, batch=self.batch, steps=self.steps or 10**7)
        prior: dict[str, Any] = made | {"schedule": self._within(PRIOR, long), "several": SeveralProcesses(device)}
        net: dict[str, Any] = made | {"prior": priors, "clutter": True, "several": self.several}
        start: dict[str, Any] = net | {"features": None if self.features == NOTHING else self.features}
        start |= {"schedule": self._within(FIRST, longer)}
        last: dict[str, Any] = net | {"refinement_loss": 6.0, "initial": str(first)}
        # of the same seed, it would be shown the same views again
        last |= {"schedule": self._within(LAST, replace(longer, learning_rate=1e-3, seed=self.seed + 1))}
        made |= {"weights": home, "threads": self.threads}
        confident = max(10 * self.views, 2 * fitting.FEWEST)  # as a part of them shows other things, or too little
        stages = (
            ("prior", lambda: is_checkpoint(priors), TrainPrior(**prior, output=priors)),
            ("network", lambda: is_checkpoint(first), TrainNet(**start, output=first)),
            ("network by the refined answer's error", lambda: is_checkpoint(home), TrainNet(**last, output=home)),
            ("bank of surfaces", (home / bank.FILE).is_file, TrainSurface(**made, views=self.views, device=device)),
            ("confidence", (home / confidences.FILE).is_file, TrainConfidence(**made, views=confident, seed=self.seed)),
        )
        for what, done, stage in stages:
            kept = processes.from_first(done)
            if processes.first:
                print(f"{name}: {what}{' is done, and kept' * kept}", file=sys.stderr, flush=True)
            if kept:
                continue
            if isinstance(stage, TrainNet):
                stage.run()
            else:
                processes.alone(stage.run)

        def measured() -> dict[str, Any]:
            if not results.is_file():
                data = Views(objects=100, views=self.views, depth_noise="on")
                write_json(results, EvalPose(category=name, weights=home, data=data).run().record, indent=1)
            return json.loads(results.read_text())

        return processes.alone(measured)

    def _check_options(self, file: Path) -> None:
        """Keep what the stages of a category are made with. Raises InputError where those that are there already were
        made with something else."""
        own = {name: getattr(self, name) for name in MADE_WITH}
        before = read_json(file, "remove it to go on with these options") if file.is_file() else own
        other = {name: before.get(name) for name, value in own.items() if before.get(name) != value}
        if other:
            told = ", ".join(f"--{name} {value} (here {own[name]})" for name, value in other.items())
            raise InputError(f"{file.parent}: belongs to a training with {told}; give those, or another --output")
        write_json(file, own)

    def _within(self, share: float, schedule: ScheduleOptions) -> ScheduleOptions:
        return replace(schedule, max_minutes=share * self.minutes)


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
