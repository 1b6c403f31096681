"""A checkpoint is a folder that is complete alone: ``config.json`` (what it is) and ``model.safetensors``."""

import json
import os
from dataclasses import asdict
from pathlib import Path
from typing import Any, ClassVar, Self, TypeVar

import safetensors
import safetensors.torch
from torch import Tensor, nn

from omad.common.arrays import digest_of
from omad.common.decode import decode
from omad.common.errors import InputError
from omad.common.files import write_atomic, write_text
from omad.common.incoming import as_path, is_file, read_json, readable
from omad.common.limits import check_limit
from omad.objects.builtin import builtin_names
from omad.objects.category import Category

from .storage.fetched import address_of, fetch
from .storage.packing import unpacked

FORMAT = 1
CHECKSUM = "sha256"
"""What the weights' file says of its numbers; earlier ones say nothing."""
LARGEST = 1e6
"""Of a weight."""
WEIGHTS = Path(__file__).parent / "weights"
"""Shipped weights: ``<category>/`` is OMADNet, ``<category>/prior/`` is OMAD-PriorNet, ``<category>/ancsh/`` A-NCSH,
``<category>/siamese/`` the Siamese network."""


class Network(nn.Module):
    """A network that can be kept: it tells its kind and sizes, and can be built from them."""

    kind: ClassVar[str]
    """What its checkpoints are called by; no other network's."""
    category: Category

    def sizes(self) -> dict[str, Any]:
        """Plain values for JSON; all that ``from_sizes`` needs besides the category."""
        return {}

    @classmethod
    def from_sizes(cls, category: Category, sizes: dict[str, Any]) -> Self:
        """A fresh network of these ``sizes``, which come as JSON gives them back (lists for tuples)."""
        raise NotImplementedError


N = TypeVar("N", bound=Network)


def save(net: Network, folder: Path, training: dict[str, Any]) -> None:
    """Write a network with its category. ``training`` is kept for the record."""
    config = {"format": FORMAT, "kind": net.kind, **net.sizes(), "category": asdict(net.category), "training": training}
    tensors = {name: tensor.detach().cpu().contiguous() for name, tensor in net.state_dict().items()}
    text = json.dumps(config, indent=1, default=str) + "\n"
    write_tensors(tensors, folder)
    write_text(folder / "config.json", text)


def write_tensors(tensors: dict[str, Tensor], folder: Path) -> None:
    """Write the weights of a checkpoint in ``folder``, with their checksum."""
    content = safetensors.torch.save(tensors, {CHECKSUM: digest_of(tensors)})
    write_atomic(folder / "model.safetensors", lambda path: path.write_bytes(content))


def load(network: type[N], folder: Path) -> N:
    """Read a network on the CPU, ready to run. Raises InputError for anything that is not its checkpoint."""
    config, path = _read_config(folder, network), folder / "model.safetensors"
    with readable(folder / "config.json", "a checkpoint's description", "copy it anew"):
        net = network.from_sizes(category_from_dict(config["category"]), config)
    if not is_file(path):
        raise InputError(f"{path}: missing; copy the whole checkpoint folder")
    with readable(path, "the weights of this network", "copy or train it anew"):
        check_limit("data_bytes", path.stat().st_size, f"{path}: the file")
        with safetensors.safe_open(path, "pt") as file:
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (it is no dict)
            checksum = (file.metadata() or {}).get(CHECKSUM)
        if checksum not in (None, digest_of(tensors)):
            raise InputError(f"{path}: is damaged (its numbers do not give its checksum); copy or train it anew")
        net.load_state_dict(unpacked(tensors))
    if not all((tensor.abs() <= LARGEST).all() for tensor in net.state_dict().values()):  # not for NaN either
        raise InputError(f"{path}: holds numbers that are not finite, or far too large; copy or train it anew")
    return net.eval().requires_grad_(False)


def is_checkpoint(folder: Path) -> bool:
    """Whether there is a checkpoint, of whatever network."""
    return is_file(folder / "config.json")


def training_record(network: type[Network], folder: Path) -> dict[str, Any]:
    """What a checkpoint remembers of its training. Raises InputError."""
    found = _read_config(folder, network).get("training", {})
    return found if isinstance(found, dict) else {}


def find_weights(name: str | Path) -> Path:
    """The folder of a category's shipped weights, or ``name`` itself where it is a checkpoint folder, or where what is
    at the address ``name`` (``fetched``) is kept. A ``Path`` is a folder, even one that is called like a category."""
    if (address := address_of(name)) is not None:
        return fetch(address)
    if isinstance(name, str) and name in builtin_names() and (WEIGHTS / name).is_dir():
        return WEIGHTS / name
    name = name if isinstance(name, Path) else str(as_path(name, "a checkpoint folder, or a category with weights"))
    if os.path.isdir(name):
        return Path(name)
    if isinstance(name, Path):
        raise InputError(f"{name}: no such folder; give the folder that a training wrote")
    known = ", ".join(shipped_categories()) or "none"
    raise InputError(f"no weights for {str(name)!r}: give a checkpoint folder or a category with weights ({known})")


def shipped_categories() -> list[str]:
    """Categories whose weights are in the package."""
    return sorted(path.parent.name for path in WEIGHTS.glob("*/config.json"))


def category_from_dict(values: dict[str, Any]) -> Category:
    """A category spec from its ``asdict`` form, as JSON gives it back. Raises ValueError for anything else. Checkpoints
    written before joints had their rest rules list them for all joints in the category's ``rest``."""
    if isinstance(values, dict) and "rest" in values:
        joints = zip(values["joints"], values["rest"], strict=True)
        values = {**values, "joints": [{**joint, "rest": rule} for joint, rule in joints]}
        del values["rest"]
    return decode(Category, values)


def _read_config(folder: Path, network: type[Network]) -> dict[str, Any]:
    path = folder / "config.json"
    if not is_checkpoint(folder):
        raise InputError(f"{folder}: no config.json here; give the folder that a training wrote")
    cure = "give the folder that a training wrote"
    config = read_json(path, cure)
    found = (config.get("format"), config.get("kind")) if isinstance(config, dict) else (None, None)
    if None in found or not isinstance(config.get("category"), dict):
        raise InputError(f"{path}: not a checkpoint of this program; {cure}")
    if found[0] != FORMAT:
        raise InputError(f"{path}: format {found[0]!r}, this version reads {FORMAT}; install its version")
    if found[1] != network.kind:
        raise InputError(f"{path}: holds a {found[1]!r} where a {network.kind!r} is needed; give the other folder")
    return config
