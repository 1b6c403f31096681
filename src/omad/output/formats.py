"""All formats by their names, as the command line asks for them. A new one is a file and an entry here."""

import glob
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from omad.common.errors import InputError
from omad.common.files import write_json
from omad.estimation.estimate import Estimate
from omad.objects.category import Category
from omad.sensing.observation import Observation

from .frame import Frame
from .gltf import save_glb
from .ply import save_ply
from .rerun import save_rrd
from .robots.mjcf import save_mjcf
from .robots.robot import Robot
from .robots.urdf import save_robot
from .robots.usd import check_joints, save_usd
from .ros import ros_messages


@dataclass(frozen=True)
class Export:
    """What is written: an estimate, in a frame, and what it was made from."""

    estimate: Estimate
    seen: Observation
    frame: Frame

    @cached_property
    def robot(self) -> Robot:
        """As simulators take it; its bodies are worked out once for all formats."""
        return Robot.of(self.estimate, "robot", self.seen, self.frame)


FORMATS: dict[str, Callable[[Export, Path], object]] = {
    "urdf": lambda export, folder: save_robot(export.robot, folder / "robot.urdf"),
    "mjcf": lambda export, folder: save_mjcf(export.robot, folder / "robot.xml"),
    "usd": lambda export, folder: save_usd(export.robot, folder / "robot.usda"),
    "ply": lambda export, folder: save_ply(export.estimate, folder, export.seen, export.frame),
    "glb": lambda export, folder: save_glb(export.estimate, folder / "object.glb", export.seen, export.frame),
    "ros": lambda export, folder: write_json(folder / "ros.json", ros_messages(export.estimate, 0, export.frame), 1),
    "rrd": lambda export, folder: save_rrd(export.estimate, folder / "object.rrd", export.seen, export.frame),
}
"""Each writes into a folder."""
NEED = {"mjcf": ("mujoco", "mujoco"), "usd": ("pxr", "usd"), "rrd": ("rerun", "rerun")}
"""Of formats that another package writes, its name and the extra's."""

OF_AN_ANSWER = (
    "object.urdf",
    "state.json",
    "estimate.png",
    "estimate.html",
    "robot.urdf",
    "robot.xml",
    "robot.usda",
    "robot-joints.json",
    "object.ply",
    "object.glb",
    "ros.json",
    "object.rrd",
)
OF_A_PART = (
    "part-{}.ply",
    "meshes/object-[0-9]*-{}.obj",
    "meshes/robot-[0-9]*-{}.obj",
    "meshes/robot-[0-9]*-{}-body-[0-9]*.obj",
)
"""Files of a folder of results that an answer may have or not, and by patterns those of a part."""


def check_formats(names: Sequence[str], category: Category | None = None) -> None:
    """Raises InputError for a name that is not in ``FORMATS``, for a format whose package is not installed, and for one
    that cannot say how objects of the ``category`` move."""
    for name in names:
        if name not in FORMATS:
            raise InputError(f"--formats {name}: no such format; choose of {', '.join(FORMATS)}")
        if name in NEED and find_spec(NEED[name][0]) is None:
            raise InputError(f"--formats {name}: needs {NEED[name][0]}; pip install 'omad[{NEED[name][1]}]'")
    if category is not None and "usd" in names:
        check_joints([joint.name for joint in category.joints], [joint.motion for joint in category.joints])


def save_formats(
    estimate: Estimate,
    observation: Observation,
    folder: str | Path,
    formats: str | Sequence[str],
    T_world_camera: Any = None,
) -> None:
    """Write the formats named, or the one, into ``folder``: ``robot.urdf``, ``robot.xml`` (MJCF), ``robot.usda``,
    ``object.ply`` and parts, ``object.glb``, ``ros.json``, ``object.rrd``; in the camera frame, or in the world, z up,
    where the camera's pose (4, 4) in it is given. Raises InputError."""
    if isinstance(estimate, Observation):
        raise InputError("save_formats: was given the observation first; give the estimate, then the observation")
    names = [formats] if isinstance(formats, str) else formats
    check_formats(names, estimate.category)
    export = Export(estimate, observation, Frame.of(T_world_camera))
    for name in names:
        FORMATS[name](export, Path(folder))


def files_of_answer(folder: Path, parts: Iterable[str]) -> list[Path]:
    """Those of an answer's files that lie in ``folder``, given the names of its object's parts."""
    parts = list(parts)
    names = {re.sub(r"[^\w-]", "_", name) for name in parts} | {name for name in parts if Path(name).name == name}
    of_parts = [pattern.format(glob.escape(name)) for name in names for pattern in OF_A_PART]
    return [file for pattern in (*OF_AN_ANSWER, *of_parts) for file in folder.glob(pattern)]
