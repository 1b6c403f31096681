"""NumPy arrays: of whatever a caller has, and kept on disk with a record of what they were made of."""

import hashlib
import json
import math
from collections.abc import Mapping
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np
from torch import Tensor, bfloat16

from .decode import Shape
from .errors import InputError
from .files import write_atomic
from .incoming import parse_json, read_arrays

Identity = dict[str, str]


def as_numpy(values: Any) -> np.ndarray:
    """NumPy array of anything array-like; a tensor may be on any device and have a gradient. What a masked array hides
    is NaN, or zero where its kind has none."""
    if isinstance(values, np.ma.MaskedArray):
        return values.filled(np.nan if values.dtype.kind == "f" else 0)
    if not isinstance(values, Tensor):
        return np.asarray(values)
    values = values.detach().cpu()
    return (values.float() if values.dtype is bfloat16 else values).numpy()  # NumPy has no such numbers


def numbers(values: Any, *shape: int | None, what: str, unknown: bool = False) -> np.ndarray:
    """(...) float64 of whatever a caller has, of that shape; None: any number. ``unknown``: NaN may stand for what is
    not known. Raises InputError for all else, which begins with ``what``."""
    wanted = Shape(*shape)
    try:
        found = np.asarray(as_numpy(values))
        if found.dtype.kind in "biuf":
            found = found.astype(np.float64)
            wanted.array(np.nan_to_num(found, posinf=np.inf, neginf=-np.inf) if unknown else found)
            return found
    except Exception as error:  # an object of a stranger's may raise anything when it is made an array
        raise InputError(f"{what}: expected {wanted}; pass such an array") from error
    raise InputError(f"{what}: expected {wanted}; pass such an array")


def number(value: Any) -> float:
    """Of whatever a caller has, an array or a tensor of one, too; NaN of what is no number."""
    try:
        if isinstance(value, Real):
            return float(value)
        found = as_numpy(value)
    except (TypeError, ValueError, RuntimeError, OverflowError):  # ragged lists; integers of hundreds of digits
        return math.nan
    return float(found.item()) if found.size == 1 and found.dtype.kind in "biuf" else math.nan


def as_doubles(values: Any) -> np.ndarray:
    """Contiguous float64 array, as compiled loops want it, of anything array-like."""
    return np.ascontiguousarray(as_numpy(values), dtype=np.float64)


def for_loops(array: np.ndarray, dtype: Any = None) -> np.ndarray:
    """As compiled loops know it: contiguous and writable, as they are compiled anew for what may only be read, as what
    other processes share is. The same array where it is so."""
    return np.require(array, dtype, ["C", "W"])


def digest_of(tensors: Mapping[str, Tensor | np.ndarray]) -> str:
    """Hexadecimal SHA-256 of numbers with their names, kinds and shapes."""
    digest = hashlib.sha256()
    for name, tensor in sorted(tensors.items()):
        array = np.ascontiguousarray(as_numpy(tensor))
        digest.update(f"{name} {array.dtype} {array.shape}\n".encode())
        digest.update(array.data)
    return digest.hexdigest()


def save_arrays(path: Path, identity: Identity, **arrays: np.ndarray) -> None:
    """Write a ``.npz``, whole or not at all, with a record of what it was made of."""
    record = json.dumps(identity)
    write_atomic(path, lambda file: np.savez_compressed(file, allow_pickle=False, identity=record, **arrays))


def load_arrays(path: Path, identity: Identity, option: str = "--cache") -> dict[str, np.ndarray] | None:
    """What ``save_arrays`` wrote; None where there is no such file. Raises InputError for another identity, and names
    the ``option`` that says where the file is."""
    if not path.is_file():
        return None
    cure = f"delete it, or give another {option}"
    arrays = read_arrays(path, "a cache", cure)
    if not isinstance(arrays, dict) or "identity" not in arrays:
        raise InputError(f"{path}: not a cache; {cure}")
    found = parse_json(str(arrays.pop("identity")), path, cure)
    found = found if isinstance(found, dict) else {}
    for name, value in identity.items():
        if found.get(name) != value:
            raise InputError(f"{path}: made with other {name}; {cure}")
    return arrays
