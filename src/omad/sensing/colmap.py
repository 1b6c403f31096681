"""Cameras of COLMAP and of what was made after it. Their images begin at the corner of the first pixel, whose middle is
where others begin."""

from contextlib import suppress
from pathlib import Path
from typing import Any

from omad.common.errors import InputError

COLMAP = {
    "SIMPLE_PINHOLE": "f cx cy",
    "PINHOLE": "fx fy cx cy",
    "SIMPLE_RADIAL": "f cx cy k1",
    "RADIAL": "f cx cy k1 k2",
    "OPENCV": "fx fy cx cy k1 k2 p1 p2",
    "FULL_OPENCV": "fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6",
    "OPENCV_FISHEYE": "fx fy cx cy k1 k2 k3 k4",
}
"""Its models, and what numbers of a line tell of each."""
NERF = {"fl_x": "fx", "fl_y": "fy", "w": "width", "h": "height", "camera_model": "model"}
"""Other names in a transforms.json of instant-ngp and Nerfstudio, whose models are COLMAP's."""


def camera_of_colmap(content: str, name: str | Path) -> dict[str, Any] | None:
    """What a cameras.txt tells of its camera, by the names that others use; None where it is no such text. Raises
    InputError where it has several, or one of a model that is unknown."""
    lines = [line.split() for line in content.splitlines() if line.strip() and not line.startswith("#")]
    if not lines or len(lines[0]) < 7 or not (lines[0][0].isdecimal() and lines[0][1].isupper()):
        return None
    (_, model, *words), *others = lines
    keys, numbers = COLMAP.get(model, "").split(), list[float]()
    with suppress(ValueError):
        numbers = [float(word) for word in words]
    if others or not numbers or len(numbers) != len(keys) + 2:
        known = f"one line ID MODEL WIDTH HEIGHT and the model's numbers, the model of {', '.join(COLMAP)}"
        raise InputError(f"{name}: not as COLMAP writes one camera; give {known}")
    told = dict(zip(("width", "height", *keys), numbers, strict=True))
    told |= {axis: told["f"] for axis in ("fx", "fy") if "f" in told}
    return _from_middle(told | {"model": model})


def camera_of_nerf(data: dict[str, Any]) -> dict[str, Any]:
    """The same of a transforms.json."""
    return _from_middle({NERF.get(key, key): value for key, value in data.items()})


def _from_middle(told: dict[str, Any]) -> dict[str, Any]:
    """With the principal point from the first pixel's middle."""
    return told | {key: told[key] - 0.5 for key in ("cx", "cy") if isinstance(told.get(key), int | float)}
