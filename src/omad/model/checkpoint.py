"""A checkpoint is a folder that is complete alone: ``config.json`` (what it is) and ``model.safetensors``."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any, ClassVar, Self, TypeVar

from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import nn

from omad.common.decode import decode
from omad.common.errors import InputError
from omad.common.files import one_line, write_atomic
from omad.objects.builtin import builtin_names
from omad.objects.category import Category

FORMAT = 1
WEIGHTS = Path(__file__).parent / "weights"
"""Shipped weights: ``<category>/`` is OMADNet, ``<category>/prior/`` is OMAD-PriorNet, ``<category>/ancsh/`` A-NCSH,
``<category>/siamese/`` the Siamese network, ``<category>/cluttered/`` an OMADNet for sloppy masks."""


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
    write_atomic(folder / "model.safetensors", lambda path: save_file(tensors, path))
    write_atomic(folder / "config.json", lambda path: path.write_text(text))


def load(network: type[N], folder: Path) -> N:
    """Read a network on the CPU, ready to run. Raises InputError for anything that is not its checkpoint."""
    config, path = _read_config(folder, network), folder / "model.safetensors"
    try:
        net = network.from_sizes(category_from_dict(config["category"]), config)
    except Exception as error:  # a network of senseless sizes raises anything
        reason = one_line(error)
        raise InputError(f"{folder / 'config.json'}: a field is missing or wrong ({reason}); copy it anew") from error
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


def is_checkpoint(folder: Path) -> bool:
    """Whether there is a checkpoint, of whatever network."""
    return (folder / "config.json").is_file()


def training_record(network: type[Network], folder: Path) -> dict[str, Any]:
    """What a checkpoint remembers of its training. Raises InputError."""
    return _read_config(folder, network)["training"]


def find_weights(name: str | Path) -> Path:
    """The folder of a category's shipped weights, or of others that are shipped for it ("laptop/cluttered"), or
    ``name`` itself where it is a checkpoint folder. A ``Path`` is a folder, even one that is called like a category."""
    if not isinstance(name, Path) and name in builtin_names() and (WEIGHTS / name).is_dir():
        return WEIGHTS / name
    if Path(name).is_dir():
        return Path(name)
    if len(Path(name).parts) == 2 and is_checkpoint(WEIGHTS / name):
        return WEIGHTS / name
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
    if "rest" in values:
        joints = zip(values["joints"], values["rest"], strict=True)
        values = {**values, "joints": [{**joint, "rest": rule} for joint, rule in joints]}
        del values["rest"]
    return decode(Category, values)


def _read_config(folder: Path, network: type[Network]) -> dict[str, Any]:
    path = folder / "config.json"
    if not is_checkpoint(folder):
        raise InputError(f"{folder}: no config.json here; give the folder that a training wrote")
    try:
        config = json.loads(path.read_text())
        found = config["format"], config["kind"]
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path}: not a checkpoint of this program; give the folder that a training wrote") from error
    if found[0] != FORMAT:
        raise InputError(f"{path}: format {found[0]}, this version reads {FORMAT}; install its version")
    if found[1] != network.kind:
        raise InputError(f"{path}: holds a {found[1]!r} where a {network.kind!r} is needed; give the other folder")
    return config
