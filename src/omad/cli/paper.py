"""The paper's tables of poses: ``omad eval table1 | table2 | ablation``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from tyro.conf import OmitArgPrefixes

import omad
from omad.common.errors import InputError
from omad.common.lazy import lazy_imports

from .answer import Answer, table
from .options import CategoriesCommand, CategoryName, Device, Json, Views, check_category, check_positive, use_threads

with lazy_imports():
    from omad.common.runtime import pick_device
    from omad.data.source import kind_of, load_objects
    from omad.evaluation.baselines.ancsh.estimator import AncshEstimator
    from omad.evaluation.paper import ablation, published
    from omad.evaluation.paper.predictions import Predictions, Predictor, Truths, kept_or_made, weights_identity
    from omad.evaluation.paper.table1 import comparison, row, rows
    from omad.evaluation.paper.true_keypoints import from_true_keypoints
    from omad.model.checkpoint import find_weights, is_checkpoint, load
    from omad.model.omadnet import OmadNet
    from omad.model.priornet import PriorNet
    from omad.objects.category import Category
    from omad.training.train_net import NetTraining


@dataclass(frozen=True, kw_only=True)
class _Table(CategoriesCommand):
    """Methods measured on the same views of several categories."""

    data: OmitArgPrefixes[Views] = Views(objects=20)
    cache: Path | None = None
    """Folder of predictions; those of other weights, settings or data are refused. Default: in the user's cache."""
    metrics: Literal["ours", "released"] = "ours"
    """released: errors as the authors' own evaluation counts them (docs/experiments.md says where it differs)."""

    def head(self, number: str) -> dict[str, Any]:
        seen = {name: getattr(self.data, name) for name in ("source", "depth_noise", "seed")}
        return {"table": number, **seen, "metrics": self.metrics}


@dataclass(frozen=True, kw_only=True)
class EvalTable1(_Table):
    """The paper's Table 1: A-NCSH, OMAD initial and OMAD refined on the same views, beside the paper's own figures.

    Predictions are kept in --cache, and the table is made from them; the same command again takes seconds."""

    def run(self) -> Answer:
        self.data.check()
        lines, compared, left_out = [], {}, []
        for folder, estimator in self.estimators():
            category = estimator.category
            methods, weights = {"omad": _method(estimator, folder)}, folder / "ancsh"
            if is_checkpoint(weights):
                ancsh = AncshEstimator.from_folder(weights, self.device)
                made_of = {"weights": weights_identity(weights), "settings": repr(ancsh.config)}
                methods["ancsh"] = Predictor(lambda seen, ancsh=ancsh: ancsh([seen])[0], made_of)
            else:
                reason = f"no weights in {weights}; pip install 'omad[baselines]', or omad train ancsh"
                left_out.append({"category": category.name, "method": "ancsh", "reason": reason})
            truths, said = _predictions(self.data, self.cache and self.cache / category.name, category, methods)
            own = rows(truths, said, category, self.metrics)
            lines += own
            compared[category.name] = comparison(own)
        found = {"rows": lines, "comparison": compared, "left_out": left_out}
        return Answer(self.head("1") | found, table1_text)


@dataclass(frozen=True, kw_only=True)
class EvalTable2(_Table):
    """The paper's Table 2: what the attention scores are good for, and what refinement makes of true keypoints.

    With and without attention are compared at the same training budget: in --ablation, where ``omad eval ablation``
    left its checkpoints, a folder a category."""

    ablation: Path = Path("omad-ablation")
    """Folder with <category>/as-it-is and <category>/no-attention. Without them those rows are left out."""

    def run(self) -> Answer:
        self.data.check()
        lines, left_out = [], []
        for folder, estimator in self.estimators():
            category, missing = estimator.category, {}
            methods = {"attention": _method(estimator, folder)}
            for method, variant in {"no attention": "no attention", "attention, same budget": "as it is"}.items():
                checkpoint = ablation.checkpoint_of(self.ablation / category.name, variant)
                if is_checkpoint(checkpoint):
                    methods[method] = _method(omad.Estimator.from_pretrained(checkpoint, self.device), checkpoint)
                else:
                    missing[method] = (
                        f"no {checkpoint}; omad eval ablation --category {category.name} --features {folder} makes it"
                    )
            truths, said = _predictions(self.data, self.cache and self.cache / category.name, category, methods)
            bound = self._true_keypoints(estimator, folder)
            if bound is None:
                missing["true keypoints"] = f"{self.data.source} holds images without their complete objects"
            else:
                said["true keypoints"] = bound
            left_out += [{"category": category.name, "method": key, "reason": why} for key, why in missing.items()]
            for method in ("no attention", "attention, same budget", "attention", "true keypoints"):
                if method in said:
                    paper = published.TABLE2.get(category.name, {}).get(method)
                    line = row(method, truths, said[method], category, self.metrics)
                    lines.append(line | {"paper": asdict(paper) if paper else None})
        return Answer(self.head("2") | {"rows": lines, "left_out": left_out}, methods_text)

    def _true_keypoints(self, estimator: omad.Estimator, folder: Path) -> Predictions | None:
        """None where the source does not show complete objects."""
        data, category = self.data, estimator.category
        if not kind_of(data.source).has_objects:
            return None
        models = load_objects(data.source, category, data.objects, "test", data.seed, data.broken)
        on_cpu = omad.Estimator(estimator.net.cpu(), estimator.config)
        return from_true_keypoints(on_cpu, load(PriorNet, folder / "prior"), models, list(data.load(category).views))


@dataclass(frozen=True, kw_only=True)
class EvalAblation:
    """What each part is good for: small trainings of equal budget with one thing changed, and the shipped network
    with one setting changed, on the same views with depth noise.

    Trainings go to --output; a killed one goes on when the same command is run again, a finished one is kept. Several
    commands with other --variants may run side by side; the table lists what is not trained yet."""

    category: CategoryName = "laptop"
    data: OmitArgPrefixes[Views] = Views(objects=20, depth_noise="on")
    cache: Path | None = None
    """Folder of predictions; those of other weights, settings or data are refused. Default: in the user's cache."""
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
    device: Device = "cpu"
    json: Json = False

    def run(self) -> Answer:
        self.data.check()
        check_positive(samples=self.samples, training_objects=self.training_objects)
        for name in self.variants:
            if name not in ablation.TRAINED:
                raise InputError(f"--variants {name!r}: is none of {', '.join(map(repr, ablation.TRAINED))}")
        category = omad.get_category(self.category)
        folder = self.output / category.name
        if self.train:
            self._train(category, folder)
        shipped, device = find_weights(self.category), pick_device(self.device)
        methods, missing = {}, []
        for name, make in ablation.SETTINGS.items():
            methods[f"shipped, {name}"] = _method(make(load(OmadNet, shipped), device=device), shipped)
        for name, variant in ablation.TRAINED.items():
            checkpoint = ablation.checkpoint_of(folder, name)
            if is_checkpoint(checkpoint):
                methods[name] = _method(omad.Estimator(load(OmadNet, checkpoint), variant.config, device), checkpoint)
            else:
                missing.append(name)
        truths, said = _predictions(
            self.data, self.cache and self.cache / category.name / "ablation", category, methods
        )
        record = {"ablation": category.name, "samples": self.samples, "depth_noise": self.data.depth_noise}
        lines = [row(name, truths, said[name], category) for name in methods]
        return Answer(record | {"rows": lines, "not_trained": missing}, ablation_text)

    def _train(self, category: Category, folder: Path) -> None:
        use_threads(self.threads)
        models = load_objects("procedural", category, self.training_objects, "train", 0, self.data.broken)
        if self.features is not None:
            net = load(OmadNet, self.features)
            check_category("--features", self.features, net.category, self.category)
            if not NetTraining().backbone.takes_weights_of(net.backbone.config):
                raise InputError(f"--features {self.features}: has no weights for a slim network; give one that has")
        budget = (self.samples, self.data.seed, pick_device(self.device), self.features)
        for name in self.variants or ablation.TRAINED:
            ablation.train_variant(ablation.TRAINED[name], category, models, folder, name, *budget)


def _method(estimator: omad.Estimator, weights: Path) -> Predictor:
    settings = f"{estimator.config}, {estimator.refine.__qualname__}"
    return Predictor(estimator, {"weights": weights_identity(weights), "settings": settings})


def _predictions(
    data: Views, cache: Path | None, category: Category, methods: dict[str, Predictor]
) -> tuple[Truths, dict[str, Predictions]]:
    """What the methods say of the views, from the cache as far as it is there. Raises InputError."""
    return kept_or_made(cache, data.identity(data.load(category)), methods, category, lambda: data.load(category))


def table1_text(answer: dict[str, Any]) -> str:
    """The paper's Table 1, the paper's own figures under ours."""
    lines = [methods_text(answer)]
    for name, found in answer["comparison"].items():
        if found:
            times = (f"{found[key]:.1f}" for key in ("alignment_over_refinement", "end_to_end") if found[key])
            lines.append(f"{name}: A-NCSH takes (alignment, end to end) {', '.join(times)} times as long")
    return "\n".join(lines)


def ablation_text(answer: dict[str, Any]) -> str:
    """Variants, and those that are missing."""
    lines = [methods_text(answer), f"trained on {answer['samples']} views each; shipped: the weights of the package"]
    return "\n".join([*lines, *(f"not trained yet: {name}" for name in answer["not_trained"])])


def methods_text(answer: dict[str, Any]) -> str:
    """Methods on the same views, a line each; the paper's own figures under ours where it has some."""
    head = ["category", "method", "joint state (°, u)", "axis (°)", "axis distance (u)", "rotation (°)", "IoU"]
    rows = [[*head, "missing", "time (ms)"]]
    for line in answer["rows"]:
        paper = line.get("paper")
        digits = {"joint_state": 3 if None in line["axis_distance"] else 1}  # lengths, or degrees
        ours = digits | {"axis_error_deg": 1, "axis_distance": 3, "rotation_error_deg": 1, "iou": 2}
        numbers = [_numbers(line[key], count) for key, count in ours.items()]
        time = _milliseconds(line["seconds"]["total"], 1)
        rows.append([line["category"], line["method"], *numbers, str(line["missing"]), time])
        if paper:
            theirs = digits | {"axis_deg": 1, "axis_distance": 3}
            numbers = [_numbers(paper[key], count) for key, count in theirs.items()]
            rows.append(["", "  in the paper", *numbers, "-", "-", "-", _milliseconds(paper.get("seconds"), 0)])
    machines = " and ".join(sorted({line["seconds"]["machine"] for line in answer["rows"]}))
    head = f"{answer.get('source', 'procedural')}, means; time of one image at a time on {machines}"
    left_out = [f"left out {r['category']} {r['method']}: {r['reason']}" for r in answer.get("left_out", [])]
    return "\n".join([head, table(rows), *left_out])


def _numbers(values: Sequence[float | None], digits: int) -> str:
    return ", ".join(f"{value:.{digits}f}" for value in values if value is not None) or "-"


def _milliseconds(seconds: float | None, digits: int) -> str:
    return "-" if seconds is None else f"{1000 * seconds:.{digits}f}"
