"""The commands about what is shipped: ``omad demo``, ``export``, ``deploy``, ``info``, ``compile``."""

import platform
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import omad
from omad.common.errors import InputError
from omad.common.files import check_folder, replacing, write_atomic
from omad.common.lazy import lazy_imports
from omad.objects.builtin import builtin_names

from .answer import Answer, as_lines, state, state_and_std, table
from .options import CategoryName, Device, Fast, Json, Seed, Weights, check_category, check_positive

with lazy_imports():
    from numpy import savez

    from omad.applications.deployment.export import deploy
    from omad.common.compiled import COMPILED
    from omad.common.runtime import pick_device
    from omad.data.rendering.tabletop import draw_tabletop
    from omad.estimation.confidence import model as confidences
    from omad.estimation.confidence.model import Confidence
    from omad.evaluation.demo import run_demo
    from omad.model.checkpoint import find_weights, is_checkpoint, load, save, shipped_categories
    from omad.model.omadnet import OmadNet
    from omad.model.priornet import PriorNet
    from omad.model.storage.fetched import write_manifest
    from omad.model.surfaces import bank


@dataclass(frozen=True, kw_only=True)
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

    def run(self) -> Answer:
        check_positive(objects=self.objects)
        check_folder(self.output)
        one = self.weights or self.category
        names = [one] if one else shipped_categories()
        estimators = [omad.Estimator.from_pretrained(name, self.device) for name in names]
        if self.category is not None:
            check_category("--weights", self.weights, estimators[0].category, self.category)
        return Answer(run_demo(estimators, self.output, self.objects, self.seed), demo_text)


def demo_text(answer: dict[str, Any]) -> str:
    """Estimate against truth, a line a joint."""
    rows = [["object", "joint", "estimate", "truth", "axis error", "axis distance", "base rotation error"]]
    for result in answer["results"]:
        errors = result["errors"]
        for j, joint in enumerate(result["estimate"]["joints"]):
            truth, distance = result["truth"]["joint_states"][j], errors["axis_distance"][j]
            apart = "-" if distance is None else f"{1000 * distance:.0f} mm"
            row = [result["object"], joint["name"], state_and_std(joint), state(joint, truth)]
            rows.append([*row, f"{errors['axis_deg'][j]:.1f}°", apart, f"{errors['rotation_deg'][0]:.1f}°"])
    lists = {"pictures": ".png", "pages for the browser, with sliders": ".html"}
    files = [[f"{name}:", *(f for f in answer["files"] if f.endswith(end))] for name, end in lists.items()]
    return "\n".join([table(rows), *(line for listed in files for line in ("", *listed))])


@dataclass(frozen=True, kw_only=True)
class Export:
    """Write a checkpoint folder that is complete alone (network, prior, category, confidence, surfaces), for other
    programs, and to be fetched from where it is put: --weights and Estimator.from_pretrained take its address."""

    category: CategoryName
    output: Path
    """Folder for the checkpoint; --weights takes it."""
    weights: Weights = None
    json: Json = False

    def run(self) -> Answer:
        check_folder(self.output)
        source = find_weights(self.weights or self.category)
        net = load(OmadNet, source)
        check_category("--weights", self.weights, net.category, self.category)
        if self.output.resolve() == source.resolve():
            raise InputError(f"--output {self.output}: is where these weights are; choose another folder")
        save(net, self.output, {"exported_from": source.name})
        prior = net.prior
        arrays = {name: getattr(prior, name) for name in ("basis", "beta_mean", "beta_covariance")}
        for layer in ("joint_hidden", "joint_out"):
            arrays |= {f"{layer}_{name}": tensor for name, tensor in getattr(prior, layer).named_parameters()}
        arrays |= {name: getattr(prior, name) for name in ("pivot_basis", "nominal_axes", "part_of")}
        plain = {name: tensor.detach().numpy() for name, tensor in arrays.items()}
        write_atomic(self.output / "prior.npz", lambda path: savez(path, allow_pickle=False, **plain))
        files = ["config.json", "model.safetensors", "prior.npz"]
        further = ["prior/config.json", "prior/model.safetensors", confidences.FILE, bank.FILE]
        with replacing([self.output / name for name in further]):  # which another checkpoint may have left
            if is_checkpoint(source / "prior"):
                save(load(PriorNet, source / "prior"), self.output / "prior", {"exported_from": source.name})
            if confidence := Confidence.load(source, net.category):
                confidence.save(self.output)
            if (beside := bank.bank_beside(source)) is not None:
                write_atomic(self.output / bank.FILE, lambda path: path.write_bytes(beside.read_bytes()))
        files += [name for name in further if (self.output / name).exists()]
        write_manifest(self.output)
        return Answer({"folder": str(self.output), "files": [*files, "manifest.json"]})


@dataclass(frozen=True, kw_only=True)
class Deploy:
    """Write an estimator as a program of its own, for machines without PyTorch: ONNX graphs, a table of numbers,
    and Python files that need NumPy and ONNX Runtime alone. A minute or two; needs omad[deploy]."""

    category: CategoryName
    output: Path
    """Folder for the program."""
    weights: Weights = None
    fast: Fast = False
    json: Json = False

    def run(self) -> Answer:
        config = omad.EstimatorConfig.fast() if self.fast else omad.EstimatorConfig()
        estimator = omad.Estimator.from_pretrained(self.weights or self.category, "cpu", config)
        check_category("--weights", self.weights, estimator.category, self.category)
        files = deploy(estimator, self.output)
        size = sum((self.output / name).stat().st_size for name in files)
        return Answer({"folder": str(self.output), "files": files, "bytes": size})


@dataclass(frozen=True, kw_only=True)
class Info:
    """Version, categories, weights found and where, device."""

    json: Json = False

    def run(self) -> Answer:
        import numpy as np
        import torch

        weights = {name: str(find_weights(name)) for name in shipped_categories()}
        record = {"version": omad.__version__, "categories": list(builtin_names()), "weights": weights}
        record |= {"device": str(pick_device("auto")), "torch": torch.__version__, "numpy": np.__version__}
        return Answer(record | {"python": platform.python_version()}, info_text)


def info_text(answer: dict[str, Any]) -> str:
    """A line a key; of weights the folder that they are in, and their names."""
    folders: dict[str, list[str]] = {}
    for name, folder in answer["weights"].items():
        folders.setdefault(f"weights in {Path(folder).parent}", []).append(name)
    return as_lines({key: value for key, value in answer.items() if key != "weights"} | folders)


@dataclass(frozen=True, kw_only=True)
class Compile:
    """Compile now what is otherwise compiled at its first use, and keep it: after an installation, say, or while a
    container is built. Done once for a machine; NUMBA_CACHE_DIR says where it is kept."""

    json: Json = False

    def run(self) -> Answer:
        began = time.perf_counter()
        estimator = omad.Estimator.from_pretrained(shipped_categories()[0], "cpu")
        scene = draw_tabletop((estimator.category.name,), (0, 0))
        seen = partial(omad.Observation.from_depth, scene.depth, scene.camera)
        for observation in (seen(scene.objects[0].mask), seen(segment="plane", drop_flying=True)):
            _ = estimator(observation).surface
        omad.Detector([estimator])(seen())
        return Answer({"compiled": len(COMPILED.names), "seconds": time.perf_counter() - began})
