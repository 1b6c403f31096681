"""What a PartNet-Mobility folder says beside its URDF: what its links and its category are called, where axes run."""

from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from omad.common.decode import Shape
from omad.common.errors import InputError
from omad.common.incoming import read_json, read_text
from omad.objects.category import Category

from .articulation import RawArticulation, RawJoint

URDF = "mobility.urdf"
NAMES = "semantics.txt"
META = "meta.json"
JOINTS = "mobility_v2.json"
MODEL_FROM_JSON = np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""The URDFs stand z up; JSON and meshes y up."""
CONTRADICTION = 0.01
"""Distance, as a share of the normalised object's radius, at which two axes are not the same."""


def is_partnet(file: Path) -> bool:
    """Whether the URDF ``file`` belongs to PartNet-Mobility: its lengths are normalised."""
    return file.name.lower() == URDF or (file.parent / NAMES).is_file()


def check_source_name(folder: Path, category: Category) -> None:
    """Raises InputError where ``meta.json`` says that the object is of another category; silent where nothing does."""
    said = _read_json(folder / META)
    stated = said.get("model_cat") if isinstance(said, dict) else None
    if isinstance(stated, str) and _plain(stated) not in {_plain(n) for n in (category.name, *category.source_names)}:
        cure = f"leave it out, or add {stated!r} to the category's source_names"
        raise InputError(f"{folder / META}: says that it is a {stated!r}, not a {category.name}; {cure}")


def with_names(raw: RawArticulation, folder: Path) -> RawArticulation:
    """Add the names of ``semantics.txt``, whose lines are: link, kind of joint, name."""
    file = folder / NAMES
    if not file.is_file():
        return raw
    lines = [line.split() for line in read_text(file, errors="replace").splitlines()]
    names = {fields[0]: fields[-1] for fields in lines if len(fields) >= 3}
    added = [(link, tuple(names[name] for name in link.names if name in names)) for link in raw.links]
    return replace(raw, links=tuple(replace(link, names=link.names + more) for link, more in added))


def with_stated_axes(raw: RawArticulation, folder: Path, scale: float) -> RawArticulation:
    """Hinges where ``mobility_v2.json`` has them, if that contradicts the URDF. The URDFs are made from that file. Some
    were edited later, and lost the places of their joints."""
    entries = _read_json(folder / JOINTS)
    entries = entries if isinstance(entries, list) else []
    stated = {f"link_{entry.get('id')}": entry for entry in entries if isinstance(entry, dict)}
    joints = []
    for joint in raw.joints:
        origin = _stated_origin(joint, [stated[name] for name in raw.links[joint.child].names if name in stated])
        if origin is not None:
            apart = np.linalg.norm(np.cross(origin * scale - joint.pivot, joint.axis))
            joint = replace(joint, pivot=origin * scale) if apart > CONTRADICTION * scale else joint
        joints.append(joint)
    return replace(raw, joints=tuple(joints))


def _stated_origin(joint: RawJoint, entries: list[dict[str, Any]]) -> np.ndarray | None:
    """(3,) a point of the axis in the model frame, normalised; None where the file has none or another axis."""
    if not joint.motion.turns or not entries:
        return None
    try:
        axis = entries[0]["jointData"]["axis"]
        origin, direction = (MODEL_FROM_JSON @ Shape(3).array(axis[key]) for key in ("origin", "direction"))
    except (KeyError, TypeError, ValueError, IndexError):
        return None
    return origin if abs(direction @ joint.axis) > 0.999 * np.linalg.norm(direction) else None


def _read_json(file: Path) -> Any:
    """None where it is missing or broken: these files only add to what the URDF says."""
    with suppress(InputError):
        return read_json(file, "")
    return None


def _plain(name: str) -> str:
    return "".join(letter for letter in name.lower() if letter.isalnum())
