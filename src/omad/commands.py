"""The commands. A dataclass is a command's options and help; ``run`` does it and returns (exit code, JSON object)."""

from __future__ import annotations

import platform
import sys
import time
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import torch
import tyro

from . import __version__
from .categories import CATEGORIES, Category, get_category
from .checkpoint import find_weights, load_net, load_priornet, save_net, save_priornet, shipped_categories
from .demo import run_demo
from .depth_noise import LEVELS
from .errors import InputError
from .estimator import Estimator, EstimatorConfig
from .evaluation import draw_worst, evaluate, summary
from .files import read_cloud, read_depth, read_intrinsics, read_mask, write_atomic
from .keypoint_check import keypoint_spread
from .objects import ObjectModel
from .observation import Observation
from .pointnet2 import PAPER_SIZE, SLIM
from .report import describe, figure, save
from .runtime import keep_freed_memory, pick_device
from .sources.folder import load_folder
from .sources.procedural import generate
from .standard_views import standard_views
from .train_net import NetTraining, train_net
from .train_prior import PriorTraining, train_prior
from .training import Schedule
from .urdf import write_urdf
from .view_check import compare_views
from .view_folder import open_views, render_to_folder

DEPTH_FILES = (".png", ".npy")
CLOUD_FILES = (".ply", ".pcd", ".xyz", ".npz")

Json = Annotated[bool, tyro.conf.arg(help="Print one JSON object on stdout and nothing else there.")]
Device = Annotated[str, tyro.conf.arg(help="cpu, cuda, or auto: CUDA where there is one.")]
Weights = Annotated[Path | None, tyro.conf.arg(help="Checkpoint folder in place of the shipped weights.")]
Result = tuple[int, dict[str, Any]]


@dataclass(frozen=True)
class Demo:
    """Recover unseen procedural objects from one depth image each; print estimate against truth and draw it."""

    category: str | None = None
    """Only this one; default: every category with weights."""
    output: Path = Path("omad-demo")
    """Folder for the pictures and URDFs."""
    objects: int = 2
    """Objects a category."""
    seed: int = 0
    weights: Weights = None
    device: Device = "cpu"
    json: Json = False

    def run(self) -> Result:
        if self.weights is not None:
            estimators = [Estimator.from_pretrained(self.weights, self.device)]
        else:
            names = [self.category] if self.category else shipped_categories()
            estimators = [Estimator.from_pretrained(name, self.device) for name in names]
        return 0, run_demo(estimators, self.output, self.objects, self.seed)


@dataclass(frozen=True)
class Estimate:
    """Estimate objects from depth images (PNG, NPY) or clouds (PLY, PCD, XYZ, NPZ): JSON, URDF and a picture each."""

    inputs: tyro.conf.Positional[tuple[Path, ...]]
    """Files, or folders of them."""
    category: str
    """Category of the objects."""
    intrinsics: str | None = None
    """Of the depth camera: fx,fy,cx,cy or a file (Open3D or RealSense JSON, ROS YAML, 3x3 text)."""
    mask: Path | None = None
    """Image, non-zero where the object is."""
    box: str | None = None
    """x1,y1,x2,y2 in pixels around the object, half-open."""
    segment: Literal["plane"] | None = None
    """plane: take away the dominant plane and keep the largest thing on it."""
    depth_scale: float | None = None
    """Metres per stored integer; default 0.001 for integer images."""
    output: Path = Path("omad-estimate")
    """Folder for results, one sub-folder an input."""
    weights: Weights = None
    device: Device = "cpu"
    json: Json = False

    def run(self) -> Result:
        estimator = Estimator.from_pretrained(self.weights or self.category, self.device)
        if self.weights is not None and estimator.category.name != self.category:
            raise InputError(f"--weights {self.weights}: for {estimator.category.name}, not for {self.category}")
        files = [file for path in self.inputs for file in _input_files(path)]
        observations = {file: self._read(file) for file in files}
        records = []
        for file, (observation, seconds) in observations.items():
            estimate = estimator(observation)
            estimate.seconds["read"] = seconds
            folder = self.output / file.stem
            _write_text(folder / "estimate.json", estimate.to_json() + "\n")
            estimate.save_urdf(folder / "object.urdf")
            save(figure(observation, estimate, title=file.name), folder / "estimate.png")
            found = ", ".join(describe(joint) for joint in estimate.joints)
            doubt = "" if estimate.converged else " (not converged)"
            print(f"{file}: {found}{doubt} -> {folder}", file=sys.stderr)
            records.append({"input": str(file), **estimate.to_dict()})
        failed = 0 if any(record["converged"] for record in records) else 1
        return failed, records[0] if len(records) == 1 else {"results": records}

    def _read(self, file: Path) -> tuple[Observation, float]:
        began = time.perf_counter()
        if file.suffix.lower() in CLOUD_FILES:
            observation = Observation.from_points(read_cloud(file), segment=self.segment)
            return observation, time.perf_counter() - began
        if self.intrinsics is None:
            raise InputError(f"{file}: a depth image needs --intrinsics fx,fy,cx,cy or a file with them")
        try:
            observation = Observation.from_depth(
                read_depth(file, self.depth_scale),
                read_intrinsics(self.intrinsics),
                mask=None if self.mask is None else read_mask(self.mask),
                box=None if self.box is None else _numbers(self.box, 4, "--box"),
                segment=self.segment,
            )
        except InputError as error:
            raise InputError(str(error) if str(file) in str(error) else f"{file}: {error}") from error
        return observation, time.perf_counter() - began


@dataclass(frozen=True)
class Generate:
    """Write procedural objects as URDF."""

    category: str
    output: Path
    objects: int = 10
    split: Literal["train", "test"] = "train"
    seed: int = 0
    json: Json = False

    def run(self) -> Result:
        category = get_category(self.category)
        written = []
        for index in range(self.objects):
            model = generate(category, index, self.split, self.seed)
            write_urdf(model, self.output / model.name / f"{model.name}.urdf")
            written.append(str(self.output / model.name / f"{model.name}.urdf"))
        return 0, {"category": category.name, "files": written}


@dataclass(frozen=True)
class Render:
    """Render standard views (depth, part labels, truth) of object models into a folder; resumes where it stopped."""

    category: str
    output: Path
    source: str = "procedural"
    """procedural, or a folder of URDF / PartNet-Mobility models."""
    objects: int = 20
    """Procedural objects."""
    split: Literal["train", "test"] = "test"
    views: int = 200
    """In total, dealt out to the objects."""
    seed: int = 0
    noise: Literal["off", "half", "on", "double"] = "off"
    """Camera noise."""
    processes: int = 1
    json: Json = False

    def run(self) -> Result:
        category = get_category(self.category)
        source = load_models(self.source, category, self.objects, self.split, self.seed)
        folder = render_to_folder(
            source.models,
            category,
            self.output,
            self.views,
            self.seed,
            LEVELS[self.noise],
            self.processes,
            progress=True,
        )
        return 0, {"folder": str(folder.path), "views": len(folder), "refused": source.refused}


@dataclass(frozen=True)
class _Training:
    """Options that both trainings share."""

    category: str
    output: Path
    """Folder for the checkpoint, the state to resume from, and the metrics. The same command resumes."""
    source: str = "procedural"
    """procedural, or a folder of URDF / PartNet-Mobility models."""
    objects: int = 1000
    """Procedural objects."""
    steps: int | None = None
    """Optimiser steps; default: the preset's."""
    batch: int | None = None
    """Samples a step; default: the preset's."""
    max_minutes: float | None = None
    """Finish within this time, learning-rate decay and all."""
    seed: int = 0
    threads: int = 0
    """CPU threads; 0: PyTorch's choice. One is faster than two where another program computes."""
    device: Device = "auto"
    json: Json = False

    def prepare(self, schedule: Schedule) -> tuple[Category, list[ObjectModel], Schedule, torch.device]:
        keep_freed_memory()
        if self.threads:
            torch.set_num_threads(self.threads)
        category = get_category(self.category)
        models = load_models(self.source, category, self.objects, "train", 0).models
        schedule = replace(schedule, seed=self.seed, max_minutes=self.max_minutes)
        if self.steps is not None:
            schedule = replace(schedule, steps=self.steps)
        if self.batch is not None:
            schedule = replace(schedule, batch=self.batch)
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
class TrainNet(_Training):
    """Train OMADNet on endless views of a category's objects."""

    prior: Path | None = None
    """Checkpoint folder of the prior; default: the shipped one."""
    initial: Path | None = None
    """OMADNet checkpoint to fine-tune (with the same prior)."""
    size: Literal["slim", "paper"] = "slim"
    """slim: fast on a CPU; paper: the paper's PointNet++."""

    def run(self) -> Result:
        category, models, schedule, device = self.prepare(NetTraining().schedule)
        prior = load_priornet(self.prior or find_weights(self.category) / "prior")
        initial = None if self.initial is None else load_net(self.initial)
        settings = NetTraining(schedule=schedule, backbone=PAPER_SIZE if self.size == "paper" else SLIM)
        net = train_net(models, category, prior, self.output, settings, device, initial)
        save_net(net, self.output, self.record(schedule))
        return 0, {"checkpoint": str(self.output)}


@dataclass(frozen=True)
class EvalPose:
    """Measure pose, joint states and joint axes on views of unseen objects, before and after refinement."""

    category: str
    source: str = "procedural"
    """procedural, a folder of URDF / PartNet-Mobility models, or a folder that ``omad render`` made."""
    objects: int = 20
    """Procedural objects."""
    views: int = 200
    """In total, dealt out to the objects."""
    seed: int = 0
    depth_noise: bool = False
    """Simulate the depth camera's noise."""
    method: Literal["least_squares", "adam"] = "least_squares"
    """How to refine; adam: the paper's own recipe, for comparison."""
    pictures: Path | None = None
    """Folder for pictures of the worst views."""
    weights: Weights = None
    device: Device = "cpu"
    json: Json = False

    def run(self) -> Result:
        config = EstimatorConfig(method=self.method)
        estimator = Estimator.from_pretrained(self.weights or self.category, self.device, config)
        category = estimator.category
        refused: list[dict[str, str]] = []
        if self.source != "procedural" and (Path(self.source) / "dataset.json").is_file():
            folder = open_views(self.source)
            if folder.category != category.name:
                raise InputError(f"{self.source}: views of {folder.category}, not of {category.name}")
            views, total = iter(folder), len(folder)
        else:
            source = load_models(self.source, category, self.objects, "test", self.seed)
            noise = LEVELS["on" if self.depth_noise else "off"]
            views, total = standard_views(source.models, category, self.views, self.seed, noise), self.views
            refused = source.refused
        results = evaluate(estimator, views, total)
        answer = summary(results, category, self.source) | {"depth_noise": self.depth_noise, "refused": refused}
        if self.pictures is not None:
            answer["pictures"] = draw_worst(results, category, self.pictures)
        return (1 if answer["failures"] == len(results) else 0), answer


@dataclass(frozen=True)
class EvalKeypoints:
    """Show that keypoints correspond: how far each one's place in its part wanders between unseen objects."""

    category: str
    objects: int = 100
    """Procedural objects, whose semantic places are known."""
    seed: int = 0
    weights: Weights = None
    """Prior checkpoint folder in place of the shipped one."""
    json: Json = False

    def run(self) -> Result:
        net = load_priornet(self.weights or find_weights(self.category) / "prior")
        models = [generate(net.category, index, "test", self.seed) for index in range(self.objects)]
        return 0, asdict(keypoint_spread(net, models))


@dataclass(frozen=True)
class EvalViews:
    """Show that training views are like rendered ones: the error of the network's first look on both."""

    category: str
    objects: int = 20
    views: int = 1000
    """Of each kind."""
    seed: int = 0
    weights: Weights = None
    json: Json = False

    def run(self) -> Result:
        folder = find_weights(self.weights or self.category)
        net, priornet = load_net(folder), load_priornet(folder / "prior")
        models = [generate(net.category, index, "test", self.seed) for index in range(self.objects)]
        return 0, asdict(compare_views(net, priornet, models, self.views, self.seed))


@dataclass(frozen=True)
class Export:
    """Write a checkpoint folder that is complete alone (network, prior, category spec), for other programs."""

    category: str
    output: Path
    weights: Weights = None
    json: Json = False

    def run(self) -> Result:
        source = find_weights(self.weights or self.category)
        net = load_net(source)
        save_net(net, self.output, {"exported_from": source.name})
        prior = net.prior
        arrays = {
            "basis": prior.basis, "beta_mean": prior.beta_mean, "beta_covariance": prior.beta_covariance,
            "joint_hidden_weight": prior.joint_hidden.weight, "joint_hidden_bias": prior.joint_hidden.bias,
            "joint_out_weight": prior.joint_out.weight, "joint_out_bias": prior.joint_out.bias,
            "nominal_axes": prior.nominal_axes, "part_of": prior.part_of,
        }  # fmt: skip
        plain = {name: tensor.detach().numpy() for name, tensor in arrays.items()}
        write_atomic(self.output / "prior.npz", lambda path: np.savez(path, allow_pickle=False, **plain))
        return 0, {"folder": str(self.output), "files": ["config.json", "model.safetensors", "prior.npz"]}


@dataclass(frozen=True)
class Info:
    """Version, categories, weights found and where, device."""

    json: Json = False

    def run(self) -> Result:
        return 0, {
            "version": __version__,
            "categories": sorted(CATEGORIES),
            "weights": {name: str(find_weights(name)) for name in shipped_categories()},
            "device": str(pick_device("auto")),
            "torch": torch.__version__,
            "numpy": np.__version__,
            "python": platform.python_version(),
        }


@dataclass(frozen=True)
class ModelSource:
    models: list[ObjectModel]
    refused: list[dict[str, str]] = field(default_factory=list)


def load_models(
    source: str, category: Category, objects: int, split: Literal["train", "test"], seed: int
) -> ModelSource:
    """Procedural objects, or those of a folder that fit; raises InputError where none does."""
    if source == "procedural":
        return ModelSource([generate(category, index, split, seed) for index in range(objects)])
    found = load_folder(source, category)
    for refusal in found.refused:
        print(f"left out {refusal.name}: {refusal.reason}", file=sys.stderr)
    if not found.models:
        raise InputError(f"{source}: none of its {len(found.refused)} models fits {category.name} (reasons above)")
    return ModelSource(found.models, [asdict(refusal) for refusal in found.refused])


def _input_files(path: Path) -> list[Path]:
    if not path.exists():
        raise InputError(f"{path}: no such file or folder; give a depth image, a cloud, or a folder of them")
    if not path.is_dir():
        return [path]
    files = sorted(p for p in path.iterdir() if p.suffix.lower() in DEPTH_FILES + CLOUD_FILES)
    if not files:
        raise InputError(f"{path}: no depth image or cloud in it; known: {' '.join(DEPTH_FILES + CLOUD_FILES)}")
    return files


def _numbers(text: str, count: int, name: str) -> list[float]:
    try:
        values = [float(word) for word in text.split(",")]
    except ValueError:
        values = []
    if len(values) != count:
        raise InputError(f"{name} {text}: expected {count} numbers with commas between them")
    return values


def _write_text(path: Path, text: str) -> None:
    write_atomic(path, lambda temporary: temporary.write_text(text))
