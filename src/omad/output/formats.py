"""All formats by their names, as the command line asks for them. A new one is a file and an entry here."""

from collections.abc import Callable, Sequence
from pathlib import Path

from omad.common.errors import InputError
from omad.common.files import write_json
from omad.estimation.estimate import Estimate
from omad.sensing.observation import Observation

from .gltf import save_glb
from .ply import save_ply
from .rerun import save_rrd
from .robot_urdf import save_robot
from .ros import ros_messages

FORMATS: dict[str, Callable[[Estimate, Observation, Path], object]] = {
    "urdf": lambda estimate, seen, folder: save_robot(estimate, folder / "robot.urdf", seen),
    "ply": lambda estimate, seen, folder: save_ply(estimate, folder, seen),
    "glb": lambda estimate, seen, folder: save_glb(estimate, folder / "object.glb", seen),
    "ros": lambda estimate, seen, folder: write_json(folder / "ros.json", ros_messages(estimate), indent=1),
    "rrd": lambda estimate, seen, folder: save_rrd(estimate, folder / "object.rrd", seen),
}
"""Each writes an estimate and what it was made from into a folder."""


def check_formats(names: Sequence[str]) -> None:
    """Raises InputError for a name that is not in ``FORMATS``."""
    for name in names:
        if name not in FORMATS:
            raise InputError(f"--formats {name}: no such format; choose of {', '.join(FORMATS)}")


def save_formats(estimate: Estimate, observation: Observation, folder: str | Path, formats: Sequence[str]) -> None:
    """Write the formats named into ``folder``: ``robot.urdf``, ``object.ply`` and parts, ``object.glb``, ``ros.json``,
    ``object.rrd``. Raises InputError."""
    check_formats(formats)
    for name in formats:
        FORMATS[name](estimate, observation, Path(folder))
