"""The commands. A dataclass is a command's options and help; ``run`` does it and returns (exit code, JSON object)."""

from __future__ import annotations

import os
import platform
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import torch
import tyro

from . import __version__
from .categories import CATEGORIES
from .checkpoint import find_weights, load_net, save_net, shipped_categories
from .demo import run_demo
from .depth_noise import LEVELS
from .errors import InputError
from .estimator import Estimator
from .exports.formats import Format, save_formats
from .files import write_atomic
from .html_report import save_html
from .inputs import InputReader, input_files
from .options import CategoryName, Device, Json, Result, Seed, Weights, check_category, check_positive
from .report import describe, figure, save
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
class Estimate:
    """Estimate objects from depth images (PNG, TIFF, NPY, NPZ) or clouds (PLY, PCD, XYZ, NPY, NPZ): JSON, URDF, a
    picture and a page for the browser (estimate.html, with sliders) each."""

    inputs: tyro.conf.Positional[tuple[Path, ...]]
    """Files, or folders of them. A bad one of many is named on stderr and under "refused" of the JSON; the others,
    under "results", are done, and the exit code is 2."""
    category: CategoryName
    intrinsics: str | None = None
    """Of the depth camera: fx,fy,cx,cy or a file (Open3D or RealSense JSON, ROS YAML, 3x3 text)."""
    mask: Path | None = None
    """Image, non-zero where the object is; or a folder with a mask for each input, of the same name."""
    box: str | None = None
    """x1,y1,x2,y2 in pixels around the object, half-open."""
    segment: Literal["plane"] | None = None
    """plane: take away the dominant plane and keep the largest thing on it."""
    depth_scale: float | None = None
    """Metres per stored number; default 0.001 for integer images, 1 for floats and clouds."""
    output: Path = Path("omad-estimate")
    """Folder for results, one sub-folder an input."""
    formats: tuple[Format, ...] = ()
    """Write these, too: urdf (in the camera frame, with masses), ply, glb (animated), ros (JSON), rrd (Rerun)."""
    weights: Weights = None
    device: Device = "cpu"
    json: Json = False

    def run(self) -> Result:
        check_positive(depth_scale=self.depth_scale)
        files = input_files(self.inputs)
        one = len(self.inputs) == 1 and files[0] == self.inputs[0]
        reader = InputReader.of(self, files)
        estimator = Estimator.from_pretrained(self.weights or self.category, self.device)
        check_category("--weights", self.weights, estimator.category, self.category)
        results, refused = [], []
        for file, name in zip(files, _folder_names(files), strict=True):
            began = time.perf_counter()
            try:
                observation = reader(file)
            except InputError as error:
                if one:
                    raise
                print(f"omad: {error}", file=sys.stderr)
                refused.append({"input": str(file), "reason": str(error)})
                continue
            seconds = time.perf_counter() - began
            estimate = estimator(observation)
            estimate.seconds["read"] = seconds
            folder = self.output / name
            estimate.save_urdf(folder / "object.urdf")
            save(figure(observation, estimate, title=file.name), folder / "estimate.png")
            save_html(observation, estimate, folder / "estimate.html", title=file.name)
            _write_text(folder / "estimate.json", estimate.to_json() + "\n")
            save_formats(estimate, observation, folder, self.formats)
            found = ", ".join(describe(joint) for joint in estimate.joints)
            doubt = "" if estimate.converged else " (not converged)"
            print(f"{file}: {found}{doubt} -> {folder}", file=sys.stderr)
            for warning in estimate.warnings:
                print(f"{file}: warning: {warning}", file=sys.stderr)
            results.append({"input": str(file), "output": str(folder), **estimate.to_dict()})
        code = 2 if refused else 0 if any(result["converged"] for result in results) else 1
        return code, results[0] if one else {"results": results, "refused": refused}


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


def _folder_names(files: Sequence[Path]) -> list[str]:
    """A folder's name for each file: its stem, or where files share that, a longer name that tells them apart."""
    places = [Path(os.path.abspath(file)) for file in files]
    for names in (
        [place.stem for place in places],
        [place.name for place in places],
        [f"{place.parent.name}-{place.name}" for place in places],
    ):
        if len(set(names)) == len(names):
            return names
    return [f"{number:05d}-{place.name}" for number, place in enumerate(places)]


def _write_text(path: Path, text: str) -> None:
    write_atomic(path, lambda temporary: temporary.write_text(text))
