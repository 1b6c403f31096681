"""The commands. A dataclass is a command's options and help; ``run`` does it and returns (exit code, JSON object)."""

from __future__ import annotations

import platform
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import torch
import tyro

from . import __version__
from .categories import CATEGORIES, get_category
from .checkpoint import find_weights, load_net, save_net, shipped_categories
from .demo import run_demo
from .depth_noise import LEVELS
from .errors import InputError
from .estimator import Estimator
from .files import read_cloud, read_depth, read_intrinsics, read_mask, write_atomic
from .observation import Observation
from .options import Device, Json, Result, Weights, check_positive
from .report import describe, figure, save
from .runtime import pick_device
from .sources.procedural import generate
from .sources.select import load_models
from .urdf import write_urdf
from .view_folder import render_to_folder

DEPTH_FILES = (".png", ".npy")
CLOUD_FILES = (".ply", ".pcd", ".xyz", ".npz")


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
        check_positive(objects=self.objects)
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
            for warning in estimate.warnings:
                print(f"{file}: warning: {warning}", file=sys.stderr)
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
        check_positive(objects=self.objects)
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
        check_positive(objects=self.objects, views=self.views, processes=self.processes)
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
