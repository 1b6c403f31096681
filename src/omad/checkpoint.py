"""A checkpoint is a folder that is complete alone: ``config.json`` (what it is) and ``model.safetensors``."""

from __future__ import annotations

import json
import math
from dataclasses import asdict
from pathlib import Path
from typing import Any

from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import nn

from .ancsh.net import AncshNet
from .categories import CATEGORIES, Category, JointSpec, PartSpec, ViewRange
from .errors import InputError
from .files import write_atomic
from .omadnet import OmadNet
from .pointnet2 import BackboneConfig
from .prior import OmadPrior
from .priornet import PriorNet
from .retrieval.siamese import SiameseNet

FORMAT = 1
WEIGHTS = Path(__file__).parent / "weights"
"""Shipped weights: ``<category>/`` is OMADNet, ``<category>/prior/`` is OMAD-PriorNet, ``<category>/ancsh/`` A-NCSH,
``<category>/siamese/`` the Siamese network."""


def save_net(net: OmadNet, folder: Path, training: dict[str, Any]) -> None:
    """Write OMADNet with its prior and category. ``training`` is kept for the record."""
    kind = {"kind": "net", "backbone": asdict(net.backbone.config), "attention": net.attention}
    _save(net, folder, kind, net.category, training)


def save_priornet(net: PriorNet, folder: Path, training: dict[str, Any]) -> None:
    """Write OMAD-PriorNet with its prior and category."""
    _save(net, folder, {"kind": "prior"}, net.category, training)


def save_ancsh(net: AncshNet, folder: Path, training: dict[str, Any]) -> None:
    """Write A-NCSH's network with its category."""
    _save(net, folder, {"kind": "ancsh", "backbone": asdict(net.backbone.config)}, net.category, training)


def save_siamese(net: SiameseNet, folder: Path, training: dict[str, Any]) -> None:
    """Write the Siamese network with its category."""
    kind = {"kind": "siamese", "backbone": asdict(net.backbone.config), "size": net.size}
    _save(net, folder, kind, net.category, training)


def load_net(folder: Path) -> OmadNet:
    """Read OMADNet on the CPU, ready to run. Raises InputError for anything that is not such a checkpoint."""
    config = _read_config(folder, "net")
    try:
        category = category_from_dict(config["category"])
        net = OmadNet(category, OmadPrior(category), _backbone(config), config.get("attention", True))
    except Exception as error:  # a network of senseless sizes raises anything
        raise _wrong_config(folder, error) from error
    return _load(net, folder)


def load_priornet(folder: Path) -> PriorNet:
    """Read OMAD-PriorNet on the CPU. Raises InputError for anything that is not such a checkpoint."""
    config = _read_config(folder, "prior")
    try:
        net = PriorNet(category_from_dict(config["category"]))
    except Exception as error:
        raise _wrong_config(folder, error) from error
    return _load(net, folder)


def load_ancsh(folder: Path) -> AncshNet:
    """Read A-NCSH's network on the CPU. Raises InputError for anything that is not such a checkpoint."""
    config = _read_config(folder, "ancsh")
    try:
        net = AncshNet(category_from_dict(config["category"]), _backbone(config))
    except Exception as error:
        raise _wrong_config(folder, error) from error
    return _load(net, folder)


def load_siamese(folder: Path) -> SiameseNet:
    """Read the Siamese network on the CPU. Raises InputError for anything that is not such a checkpoint."""
    config = _read_config(folder, "siamese")
    try:
        net = SiameseNet(category_from_dict(config["category"]), _backbone(config), config["size"])
    except Exception as error:
        raise _wrong_config(folder, error) from error
    return _load(net, folder)


def training_record(folder: Path) -> dict[str, Any]:
    """What an OMADNet checkpoint remembers of its training. Raises InputError."""
    return _read_config(folder, "net")["training"]


def find_weights(name: str | Path) -> Path:
    """The folder of a category's shipped weights, or ``name`` itself where it is a checkpoint folder.

    A ``Path`` is always a folder, even one that is called like a category.
    """
    if not isinstance(name, Path) and name in CATEGORIES and (WEIGHTS / name).is_dir():
        return WEIGHTS / name
    if Path(name).is_dir():
        return Path(name)
    if isinstance(name, Path):
        raise InputError(f"{name}: no such folder; give the folder that a training wrote")
    known = ", ".join(shipped_categories()) or "none"
    raise InputError(f"no weights for {str(name)!r}: give a checkpoint folder or a category with weights ({known})")


def shipped_categories() -> list[str]:
    """Categories whose weights are in the package."""
    return sorted(path.parent.name for path in WEIGHTS.glob("*/config.json"))


def category_from_dict(values: dict[str, Any]) -> Category:
    """A category spec from its ``asdict`` form, as JSON gives it back."""
    values = {key: _tuples(value) for key, value in values.items()}
    values["parts"] = tuple(PartSpec(**{k: _tuples(v) for k, v in part.items()}) for part in values["parts"])
    values["joints"] = tuple(JointSpec(**{k: _tuples(v) for k, v in joint.items()}) for joint in values["joints"])
    values["views"] = ViewRange(**{k: _tuples(v) for k, v in values["views"].items()})
    if not 0 < values["metres_per_unit"] < math.inf:
        raise ValueError("metres_per_unit must be above 0")
    return Category(**values)


def _backbone(config: dict[str, Any]) -> BackboneConfig:
    return BackboneConfig(**{key: _tuples(value) for key, value in config["backbone"].items()})


def _tuples(value: Any) -> Any:
    return tuple(_tuples(item) for item in value) if isinstance(value, list) else value


def _save(net: nn.Module, folder: Path, kind: dict[str, Any], category: Category, training: dict[str, Any]) -> None:
    config = {"format": FORMAT, **kind, "category": asdict(category), "training": training}
    tensors = {name: tensor.detach().cpu().contiguous() for name, tensor in net.state_dict().items()}
    text = json.dumps(config, indent=1, default=str) + "\n"
    write_atomic(folder / "model.safetensors", lambda path: save_file(tensors, path))
    write_atomic(folder / "config.json", lambda path: path.write_text(text))


def _read_config(folder: Path, kind: str) -> dict[str, Any]:
    path = folder / "config.json"
    if not path.is_file():
        raise InputError(f"{folder}: no config.json here; give the folder that a training wrote")
    try:
        config = json.loads(path.read_text())
        found = config["format"], config["kind"]
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path}: not a checkpoint of this program; give the folder that a training wrote") from error
    if found[0] != FORMAT:
        raise InputError(f"{path}: format {found[0]}, this version reads {FORMAT}; install its version")
    if found[1] != kind:
        raise InputError(f"{path}: holds a {found[1]!r} where a {kind!r} is needed; give the other folder")
    return config


def _wrong_config(folder: Path, error: Exception) -> InputError:
    reason = " ".join(str(error).split()) or type(error).__name__
    return InputError(f"{folder / 'config.json'}: a field is missing or wrong ({reason}); copy it anew")


def _load(net, folder: Path):
    path = folder / "model.safetensors"
    try:
        net.load_state_dict(load_file(path))
    except FileNotFoundError as error:
        raise InputError(f"{path}: missing; copy the whole checkpoint folder") from error
    except (SafetensorError, RuntimeError, OSError) as error:
        reason = str(error).splitlines()[0].rstrip(":")
        raise InputError(f"{path}: damaged or of another network ({reason}); copy or train it anew") from error
    if not all(tensor.isfinite().all() for tensor in net.state_dict().values()):
        raise InputError(f"{path}: holds numbers that are not finite; copy or train it anew")
    return net.eval().requires_grad_(False)
