"""Where the camera was at each frame of a sequence."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from omad.common.errors import InputError
from omad.sensing.camera_files import read_transform

from .frames import FrameFile

NAME = "T_world_camera"
SUFFIXES = (".txt", ".json", ".npy", ".yaml")


@dataclass
class CameraPlaces:
    """T_world_camera of frames, from one file for all of them, or from a folder with a file a frame, of its name."""

    path: Path
    one: np.ndarray | None = field(init=False, default=None)

    def __post_init__(self) -> None:
        """Raises InputError for a file that is none."""
        if not self.path.is_dir():
            self.one = read_transform(self.path, NAME)

    def __call__(self, frame: FrameFile) -> np.ndarray:
        """(4, 4) of a frame. Raises InputError where there is none."""
        if self.one is not None:
            return self.one
        for suffix in SUFFIXES:
            if (file := self.path / f"{frame.path.stem}{suffix}").is_file():
                return read_transform(file, NAME)
        raise InputError(f"{self.path}: no {NAME} for {frame.path} in it; name a file like the frame, .txt or .json")
