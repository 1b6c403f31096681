"""All formats by their names, as the command line asks for them."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from ..estimate import Estimate
from ..files import write_atomic
from ..observation import Observation
from .gltf import save_glb
from .recording import save_rrd
from .robot import save_robot
from .ros import ros_messages
from .surfaces import save_ply

Format = Literal["urdf", "ply", "glb", "ros", "rrd"]


def save_formats(estimate: Estimate, observation: Observation, folder: str | Path, formats: Sequence[Format]) -> None:
    """Write the formats named into ``folder``: ``robot.urdf``, ``object.ply`` and parts, ``object.glb``, ``ros.json``,
    ``object.rrd``."""
    folder = Path(folder)
    for name in formats:
        match name:
            case "urdf":
                save_robot(estimate, folder / "robot.urdf", observation)
            case "ply":
                save_ply(estimate, folder, observation)
            case "glb":
                save_glb(estimate, folder / "object.glb", observation)
            case "ros":
                text = json.dumps(ros_messages(estimate), indent=1) + "\n"
                write_atomic(folder / "ros.json", lambda path, text=text: path.write_text(text))
            case "rrd":
                save_rrd(estimate, folder / "object.rrd", observation)
