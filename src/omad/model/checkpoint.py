"""A checkpoint is a folder that is complete alone: ``config.json`` (what it is) and ``model.safetensors``."""

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any, ClassVar, Self, TypeVar

import safetensors
import safetensors.torch
from torch import Tensor, nn

from omad.common.arrays import digest_of
from omad.common.decode import decode
from omad.common.errors import InputError, unknown
from omad.common.files import write_atomic, write_json
from omad.common.incoming import CHECKSUM, address_of, as_path, check_seal, is_file, read_sealed, readable, sealed
from omad.common.limits import check_limit
from omad.common.runtime import undrawn
from omad.objects.builtin import AUTO, builtin_names
from omad.objects.category import Category

from .storage.fetched import fetch
from .storage.packing import unpacked

FORMAT = 1
STATE = "state.pt"
"""In the folder of a training: what it goes on with. A checkpoint is there once it has ended."""
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
    """Of a network of a single one."""

    def described(self) -> dict[str, Any]:
        """All that a checkpoint tells of the network, plain values for JSON."""
        return {**self.sizes(), "category": asdict(self.category)}

    @classmethod
    def from_description(cls, config: dict[str, Any]) -> Self:
        """A fresh network of which a checkpoint tells this, as JSON gives it back."""
        return cls.from_sizes(category_from_dict(config["category"]), config)

    def sizes(self) -> dict[str, Any]:
        """Plain values for JSON; all that ``from_sizes`` needs besides the category."""
        return {}

    @classmethod
    def from_sizes(cls, category: Category, sizes: dict[str, Any]) -> Self:
        """A fresh network of these ``sizes``, which come as JSON gives them back (lists for tuples)."""
        raise NotImplementedError


N = TypeVar("N", bound=Network)
M = TypeVar("M", bound=nn.Module)


def save(net: Network, folder: Path, training: dict[str, Any]) -> None:
    """Write a network with what it tells of itself. ``training`` is kept for the record."""
    config = {"format": FORMAT, "kind": net.kind, **net.described(), "training": training}
    tensors = {name: tensor.detach().cpu().contiguous() for name, tensor in net.state_dict().items()}
    record = sealed(json.loads(json.dumps(config, default=str)))
    write_tensors(tensors, folder)
    write_json(folder / "config.json", record, indent=1)


def write_tensors(tensors: dict[str, Tensor], folder: Path) -> None:
    """Write the weights of a checkpoint in ``folder``, with their checksum."""
    content = safetensors.torch.save(tensors, {CHECKSUM: digest_of(tensors)})
    write_atomic(folder / "model.safetensors", lambda path: path.write_bytes(content))


def load(network: type[N], folder: Path) -> N:
    """Read a network on the CPU, ready to run. Raises InputError for anything that is not its checkpoint."""
    config, path = _read_config(folder, network), folder / "model.safetensors"
    with readable(folder / "config.json", "a checkpoint's description", "copy it anew"), undrawn():
        net = network.from_description(config)
    with _opened(folder) as file:
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (it is no dict)
        checksum = (file.metadata() or {}).get(CHECKSUM)
        if checksum is not None:
            check_seal(checksum, digest_of(tensors), path, "copy or train it anew")
        net.load_state_dict(unpacked(tensors))
    if not all((tensor.abs() <= LARGEST).all() for tensor in net.state_dict().values()):  # not for NaN either
        raise InputError(f"{path}: holds numbers that are not finite, or far too large; copy or train it anew")
    return net.float().eval().requires_grad_(False)


def load_part(module: M, prefix: str, folder: Path) -> M:
    """Read into a part of a checkpoint's network the weights whose names begin with ``prefix``, and no others. Raises
    InputError."""
    with _opened(folder) as file:
        names = [name for name in file.keys() if name.startswith(prefix)]  # noqa: SIM118 (it is no dict)
        module.load_state_dict(unpacked({name.removeprefix(prefix): file.get_tensor(name) for name in names}))
    return module.float().eval().requires_grad_(False)


@contextmanager
def _opened(folder: Path) -> Iterator[Any]:
    """The weights' file of a checkpoint. Raises InputError, also for what a reader of it raises."""
    path = folder / "model.safetensors"
    if not is_file(path):
        raise InputError(f"{path}: missing; copy the whole checkpoint folder")
    with readable(path, "the weights of this network", "copy or train it anew"):
        check_limit("data_bytes", path.stat().st_size, f"{path}: the file")
        with safetensors.safe_open(path, "pt") as file:
            yield file


def is_checkpoint(folder: Path) -> bool:
    """Whether there is a checkpoint, of whatever network."""
    return is_file(folder / "config.json")


def training_record(network: type[Network], folder: Path) -> dict[str, Any]:
    """What a checkpoint remembers of its training. Raises InputError."""
    found = _read_config(folder, network).get("training", {})
    return found if isinstance(found, dict) else {}


def category_of(network: type[Network], folder: Path) -> Category:
    """What the network of a checkpoint is of; reads no weights. Raises InputError."""
    config = _read_config(folder, network)
    with readable(folder / "config.json", "a checkpoint's description", "copy it anew"):
        return category_from_dict(config["category"])


def find_weights(name: str | Path) -> Path:
    """The folder of a category's shipped weights, or ``name`` itself where it is a checkpoint folder, or where what is
    at the address ``name`` (``fetched``) is kept. A ``Path`` is a folder, even one that is called like a category."""
    if (address := address_of(name)) is not None:
        return fetch(address)
    if isinstance(name, str) and name in builtin_names() and (WEIGHTS / name).is_dir():
        return WEIGHTS / name
    folder = as_path(name, "a checkpoint folder, or a category with weights")
    if os.path.isdir(folder):
        return folder
    if isinstance(name, Path) or os.path.dirname(name):
        raise InputError(f"{name}: no such folder; give the folder that a training wrote")
    known = shipped_categories()
    if name == AUTO:
        finds = "omad estimate, omad detect and omad serve find out which"
        raise InputError(f"{AUTO}: stands for any category, here one has to be named ({', '.join(known)}); {finds}")
    raise InputError(
        f"no weights for {unknown(str(name), known)}: give a checkpoint folder (--weights) or a category with weights "
        f"({', '.join(known) or 'none'}; "
        "pip install 'omad[categories]' brings all that there are)"
    )


def meant_weights(option: str, name: str) -> Path:
    """``find_weights`` of a word that may be a category or a folder. Raises InputError, with the ``option``, also where
    it is both: which of them is meant, it does not tell."""
    if name in shipped_categories() and is_checkpoint(Path(name)):
        cure = f"give ./{name} for the folder, {WEIGHTS / name} for the shipped one"
        raise InputError(f"{option} {name}: is a category with shipped weights, and a checkpoint folder here; {cure}")
    return find_weights(name)


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
    cure = "give the folder that a training wrote"
    if not is_checkpoint(folder) and (folder / STATE).is_file():
        raise InputError(f"{folder}: its training was interrupted; give the same command again, which goes on with it")
    if not is_checkpoint(folder):
        inside = "give one of the folders in it, that of a category"
        raise InputError(f"{folder}: no config.json here; {inside if any(folder.glob('*/config.json')) else cure}")
    config = read_sealed(path, cure)
    found = (config.get("format"), config.get("kind")) if isinstance(config, dict) else (None, None)
    if None in found:
        raise InputError(f"{path}: not a checkpoint of this program; {cure}")
    if found[0] != FORMAT:
        raise InputError(f"{path}: format {found[0]!r}, this version reads {FORMAT}; install its version")
    if found[1] != network.kind:
        raise InputError(f"{path}: holds a {found[1]!r} where a {network.kind!r} is needed; give the other folder")
    return config
