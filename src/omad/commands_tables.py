"""The commands that make the paper's tables and ablations."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import torch

from . import __version__
from .ancsh.estimator import AncshEstimator
from .categories import Category
from .checkpoint import WEIGHTS, find_weights, load_net, load_priornet
from .errors import InputError
from .estimator import Estimator
from .experiments.ablation import checkpoint_of, train_variant
from .experiments.paper import TABLE2
from .experiments.predictions import (
    Method,
    Predictions,
    Truths,
    data_identity,
    kept_or_made,
    weights_identity,
)
from .experiments.table1 import Metrics, comparison, row, rows
from .experiments.true_keypoints import from_true_keypoints
from .experiments.variants import SETTINGS, TRAINED
from .options import BrokenFiles, CategoryName, Device, Json, Result, Seed, check_category, check_positive
from .runtime import keep_freed_memory, pick_device
from .sources.select import ViewSource, load_training_objects, load_views, shown_objects
from .spec_file import get_category
from .train_net import NetTraining


@dataclass(frozen=True)
class _OnViews:
    """Options of all that is measured on views."""

    source: str = "procedural"
    """procedural, or a folder as ``omad eval pose`` takes it (an ArtImage root, say)."""
    objects: int = 20
    """Procedural objects a category."""
    views: int = 200
    """A category, in total; of a rendered folder or an ArtImage root always all."""
    seed: Seed = 0
    depth_noise: bool = False
    """Simulate the depth camera's noise."""
    broken: BrokenFiles = "refuse"
    cache: Path = Path("omad-predictions")
    """Folder of predictions. Those of other weights, settings or data are refused."""
    device: Device = "cpu"
    json: Json = False

    def check(self) -> None:
        check_positive(objects=self.objects, views=self.views)

    def load(self, category: Category) -> ViewSource:
        return load_views(self.source, category, self.objects, self.views, self.seed, self.depth_noise, self.broken)

    def data(self, category: Category) -> dict[str, str]:
        """Tells these views from others."""
        settings = {"objects": self.objects, "views": self.views, "seed": self.seed, "noise": self.depth_noise}
        first = list(islice(self.load(category).views, 3))
        return {"data": data_identity(first, self.source, settings), "version": __version__}

    def predictions(
        self, category: Category, methods: dict[str, Method], folder: str = ""
    ) -> tuple[Truths, dict[str, Predictions]]:
        cache = self.cache / category.name / folder
        return kept_or_made(cache, self.data(category), methods, category, lambda: self.load(category))


@dataclass(frozen=True)
class _Tables(_OnViews):
    """Options of the paper's tables."""

    categories: tuple[str, ...] = ()
    """Default: all with weights."""
    weights: Path | None = None
    """Folder in place of the shipped weights, with <category>/ of OMADNet, <category>/prior and <category>/ancsh; where
    there is no ancsh/, A-NCSH is left out."""
    metrics: Metrics = "ours"
    """released: errors as the authors' own evaluation counts them (docs/experiments.md says where it differs)."""

    def folders(self) -> dict[str, Path]:
        """Of weights, by category."""
        folder = self.weights or WEIGHTS
        names = self.categories or tuple(sorted(path.parent.name for path in folder.glob("*/config.json")))
        if not names:
            raise InputError(f"{folder}: no <category>/config.json in it; give a folder with one checkpoint a category")
        return {name: folder / name for name in names}

    def head(self, table: str) -> dict[str, Any]:
        return {
            "table": table,
            "source": self.source,
            "depth_noise": self.depth_noise,
            "seed": self.seed,
            "metrics": self.metrics,
        }


@dataclass(frozen=True)
class EvalTable1(_Tables):
    """The paper's Table 1: A-NCSH, OMAD initial and OMAD refined on the same views, beside the paper's own figures.

    Predictions are kept in --cache, and the table is made from them; the same command again takes seconds."""

    def run(self) -> Result:
        self.check()
        lines: list[dict[str, Any]] = []
        compared, left_out = {}, []
        for name, folder in self.folders().items():
            estimator = Estimator.from_pretrained(folder, self.device)
            methods = {"omad": _method(estimator, folder)}
            if (folder / "ancsh" / "config.json").is_file():
                ancsh = AncshEstimator.from_folder(folder / "ancsh", self.device)
                made_of = {"weights": weights_identity(folder / "ancsh"), "settings": repr(ancsh.config)}
                methods["ancsh"] = Method(lambda seen, ancsh=ancsh: ancsh([seen])[0], made_of)
            else:
                reason = f"no weights in {folder / 'ancsh'}; omad train ancsh makes them"
                left_out.append({"category": name, "method": "ancsh", "reason": reason})
            truths, said = self.predictions(estimator.category, methods)
            own = rows(truths, said, estimator.category, self.metrics)
            lines += own
            compared[name] = comparison(own)
        return 0, self.head("1") | {"rows": lines, "comparison": compared, "left_out": left_out}


@dataclass(frozen=True)
class EvalTable2(_Tables):
    """The paper's Table 2: what the attention scores are good for, and what refinement makes of true keypoints.

    With and without attention are compared at the same training budget: in --ablation, where ``omad eval ablation``
    left its checkpoints, a folder a category."""

    ablation: Path = Path("omad-ablation")
    """Folder with <category>/as-it-is and <category>/no-attention. Without them those rows are left out."""

    def run(self) -> Result:
        self.check()
        lines: list[dict[str, Any]] = []
        left_out = []
        for name, folder in self.folders().items():
            estimator = Estimator.from_pretrained(folder, self.device)
            category = estimator.category
            methods = {"attention": _method(estimator, folder)}
            for row_name, variant in {"no attention": "no attention", "attention, same budget": "as it is"}.items():
                checkpoint = checkpoint_of(self.ablation / name, variant)
                if (checkpoint / "config.json").is_file():
                    methods[row_name] = _method(Estimator.from_pretrained(checkpoint, self.device), checkpoint)
                else:
                    reason = f"no {checkpoint}; omad eval ablation --category {name} makes it"
                    left_out.append({"category": name, "method": row_name, "reason": reason})
            truths, said = self.predictions(category, methods)
            bound = self._true_keypoints(estimator, folder)
            if bound is None:
                reason = f"{self.source} holds images without their complete objects"
                left_out.append({"category": name, "method": "true keypoints", "reason": reason})
            else:
                said["true keypoints"] = bound
            order = ("no attention", "attention, same budget", "attention", "true keypoints")
            for method in order:
                if method in said:
                    paper = TABLE2.get(name, {}).get(method)
                    line = row(method, truths, said[method], category, self.metrics)
                    lines.append(line | {"paper": asdict(paper) if paper else None})
        return 0, self.head("2") | {"rows": lines, "left_out": left_out}

    def _true_keypoints(self, estimator: Estimator, folder: Path) -> Predictions | None:
        """None where the source does not show complete objects."""
        models = shown_objects(self.source, estimator.category, self.objects, self.seed, self.broken)
        if models is None:
            return None
        on_cpu = Estimator(estimator.net.cpu(), estimator.config)
        views = list(self.load(estimator.category).views)
        return from_true_keypoints(on_cpu, load_priornet(folder / "prior"), models, views)


@dataclass(frozen=True)
class EvalAblation(_OnViews):
    """What each part is good for: small trainings of equal budget with one thing changed, and the shipped network
    with one setting changed, on the same views with depth noise.

    Trainings go to --output; a killed one goes on when the same command is run again, a finished one is kept. Several
    commands with other --variants may run side by side; the table lists what is not trained yet."""

    category: CategoryName = "laptop"
    depth_noise: bool = True
    """Simulate the depth camera's noise."""
    samples: int = 16_000
    """Views that a variant's network is trained on; its prior sees twice as many clouds."""
    variants: tuple[str, ...] = ()
    """Which to train; default: all. Quote them: "no attention"."""
    features: Path | None = None
    """Checkpoint of an OMADNet whose backbone every variant starts from, with new heads and a prior of its own: a small
    budget then goes further. Default: from nothing."""
    training_objects: int = 600
    """Procedural objects to train on."""
    output: Path = Path("omad-ablation")
    """Folder for a sub-folder a category."""
    train: bool = True
    """no-train: make the table from what is trained already."""
    threads: int = 0
    """CPU threads of the training; 0: PyTorch's choice."""

    def run(self) -> Result:
        self.check()
        check_positive(samples=self.samples, training_objects=self.training_objects)
        unknown = [name for name in self.variants if name not in TRAINED]
        if unknown:
            raise InputError(f"--variants {unknown[0]!r}: is none of {', '.join(map(repr, TRAINED))}")
        category, folder = get_category(self.category), self.output / get_category(self.category).name
        if self.train:
            self._train(category, folder)
        shipped = find_weights(self.category)
        methods = {
            f"shipped, {name}": _method(Estimator(load_net(shipped), config, pick_device(self.device)), shipped)
            for name, config in SETTINGS.items()
        }
        missing = []
        for name, variant in TRAINED.items():
            checkpoint = checkpoint_of(folder, name)
            if (checkpoint / "config.json").is_file():
                estimator = Estimator(load_net(checkpoint), variant.config, pick_device(self.device))
                methods[name] = _method(estimator, checkpoint)
            else:
                missing.append(name)
        truths, said = self.predictions(category, methods, "ablation")
        lines = [row(name, truths, found, category) for name, found in said.items()]
        return 0, {
            "ablation": category.name,
            "samples": self.samples,
            "depth_noise": self.depth_noise,
            "rows": sorted(lines, key=lambda line: list(methods).index(line["method"])),
            "not_trained": missing,
        }

    def _train(self, category: Category, folder: Path) -> None:
        keep_freed_memory()
        if self.threads:
            torch.set_num_threads(self.threads)
        models = load_training_objects("procedural", category, self.training_objects, 0, self.broken)
        if self.features is not None:
            net = load_net(self.features)
            check_category("--features", self.features, net.category, self.category)
            if net.backbone.config != NetTraining().backbone:
                raise InputError(f"--features {self.features}: is not slim, as variants are; give one that is")
        device = pick_device(self.device)
        for name in self.variants or TRAINED:
            variant = TRAINED[name]
            train_variant(variant, category, models, folder, name, self.samples, self.seed, device, self.features)


def _method(estimator: Estimator, weights: Path) -> Method:
    return Method(estimator, {"weights": weights_identity(weights), "settings": repr(estimator.config)})
