"""The commands. A dataclass is a command's options and help; ``run`` does it and returns (exit code, JSON object)."""

from __future__ import annotations

import platform
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import torch

from . import __version__
from .categories import CATEGORIES
from .checkpoint import find_weights, load_net, save_net, shipped_categories
from .demo import run_demo
from .depth_noise import LEVELS
from .estimator import Estimator
from .files import write_atomic
from .options import CategoryName, Device, Json, Result, Seed, Weights, check_category, check_positive
from .runtime import pick_device
from .sources.artimage import write_artimage
from .sources.procedural import generate
from .sources.select import load_models
from .spec_file import get_category
from .urdf import write_urdf
from .view_folder import render_to_folder


@dataclass(frozen=True)
class Demo:
    """Recover unseen procedural objects from one depth image each; print estimate against truth and draw it."""

    category: str | None = None
    """Only this one; default: every category with weights."""
    output: Path = Path("omad-demo")
    """Folder for the pictures and URDFs."""
    objects: int = 2
    """Objects a category."""
    seed: Seed = 0
    weights: Weights = None
    device: Device = "cpu"
    json: Json = False

    def run(self) -> Result:
        check_positive(objects=self.objects)
        if self.weights is not None:
            estimators = [Estimator.from_pretrained(self.weights, self.device)]
            if self.category is not None:
                check_category("--weights", self.weights, estimators[0].category, self.category)
        else:
            names = [self.category] if self.category else shipped_categories()
            estimators = [Estimator.from_pretrained(name, self.device) for name in names]
        return 0, run_demo(estimators, self.output, self.objects, self.seed)


@dataclass(frozen=True)
class Generate:
    """Write procedural objects as URDF."""

    category: CategoryName
    output: Path
    """Folder for a sub-folder an object, each with its URDF and meshes."""
    objects: int = 10
    """How many."""
    split: Literal["train", "test"] = "train"
    """test: objects that no training has seen."""
    seed: Seed = 0
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

    category: CategoryName
    output: Path
    """Folder for the views; the same command goes on in it, another one is refused."""
    source: str = "procedural"
    """procedural, or a folder of URDF / PartNet-Mobility models."""
    objects: int = 20
    """Procedural objects."""
    split: Literal["train", "test"] = "test"
    """Of the procedural objects; layout artimage: of all whose name is no number, as those are split by it."""
    layout: Literal["omad", "artimage"] = "omad"
    """artimage: as the ArtImage data set is laid out; another run adds another split or category to the same folder."""
    views: int = 200
    """In total, dealt out to the objects."""
    seed: Seed = 0
    noise: Literal["off", "half", "on", "double"] = "off"
    """Camera noise."""
    processes: int = 1
    """That render at a time; the views are the same for any number."""
    json: Json = False

    def run(self) -> Result:
        check_positive(objects=self.objects, views=self.views, processes=self.processes)
        category = get_category(self.category)
        source = load_models(self.source, category, self.objects, self.split, self.seed)
        noise, drawn = LEVELS[self.noise], (source.models, category, self.output, self.views)
        if self.layout == "artimage":
            write_artimage(*drawn, self.split, self.seed, noise, self.processes, progress=True)
        else:
            render_to_folder(*drawn, self.seed, noise, self.processes, progress=True)
        return 0, {"folder": str(self.output), "views": self.views, "refused": source.refused}


@dataclass(frozen=True)
class Export:
    """Write a checkpoint folder that is complete alone (network, prior, category spec), for other programs."""

    category: CategoryName
    output: Path
    """Folder for the checkpoint; --weights takes it."""
    weights: Weights = None
    json: Json = False

    def run(self) -> Result:
        source = find_weights(self.weights or self.category)
        net = load_net(source)
        check_category("--weights", self.weights, net.category, self.category)
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
