"""All formats by their names, as the command line asks for them. A new one is a file and an entry here."""

from collections.abc import Callable, Sequence
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from omad.common.errors import InputError
from omad.common.files import write_json
from omad.estimation.estimate import Estimate
from omad.sensing.observation import Observation

from .frame import Frame
from .gltf import save_glb
from .ply import save_ply
from .rerun import save_rrd
from .robots.mjcf import save_mjcf
from .robots.urdf import save_robot
from .robots.usd import save_usd
from .ros import ros_messages

FORMATS: dict[str, Callable[[Estimate, Observation, Path, Frame], object]] = {
    "urdf": lambda estimate, seen, folder, frame: save_robot(estimate, folder / "robot.urdf", seen, frame),
    "mjcf": lambda estimate, seen, folder, frame: save_mjcf(estimate, folder / "robot.xml", seen, frame),
    "usd": lambda estimate, seen, folder, frame: save_usd(estimate, folder / "robot.usda", seen, frame),
    "ply": lambda estimate, seen, folder, frame: save_ply(estimate, folder, seen, frame),
    "glb": lambda estimate, seen, folder, frame: save_glb(estimate, folder / "object.glb", seen, frame),
    "ros": lambda estimate, _, folder, frame: write_json(folder / "ros.json", ros_messages(estimate, 0, frame), 1),
    "rrd": lambda estimate, seen, folder, frame: save_rrd(estimate, folder / "object.rrd", seen, frame),
}
"""Each writes an estimate, and what it was made from, into a folder, in a frame."""
NEED = {"mjcf": ("mujoco", "mujoco"), "usd": ("pxr", "usd"), "rrd": ("rerun", "rerun")}
"""Of formats that another package writes, its name and the extra's."""


def check_formats(names: Sequence[str]) -> None:
    """Raises InputError for a name that is not in ``FORMATS``, and for a format whose package is not installed."""
    for name in names:
        if name not in FORMATS:
            raise InputError(f"--formats {name}: no such format; choose of {', '.join(FORMATS)}")
        if name in NEED and find_spec(NEED[name][0]) is None:
            raise InputError(f"--formats {name}: needs {NEED[name][0]}; pip install 'omad[{NEED[name][1]}]'")


def save_formats(
    estimate: Estimate,
    observation: Observation,
    folder: str | Path,
    formats: Sequence[str],
    T_world_camera: np.ndarray | None = None,
) -> None:
    """Write the formats named into ``folder``: ``robot.urdf``, ``robot.xml`` (MJCF), ``robot.usda``, ``object.ply`` and
    parts, ``object.glb``, ``ros.json``, ``object.rrd``; in the camera frame, or in the world, z up, where the camera's
    pose (4, 4) in it is given. Raises InputError."""
    check_formats(formats)
    for name in formats:
        FORMATS[name](estimate, observation, Path(folder), Frame.of(T_world_camera))
