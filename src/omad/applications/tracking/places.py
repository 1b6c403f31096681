"""Where the camera was at each frame of a sequence."""

import sys
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from omad.common.errors import InputError
from omad.estimation.world import unit_doubts
from omad.sensing.camera_files import read_transform

from .frames import FrameFile

NAME = "T_world_camera"
SUFFIXES = (".txt", ".json", ".npy", ".yaml")


@dataclass
class CameraPlaces:
    """T_world_camera of frames, from one file for all of them, or from a folder with a file a frame, of its name."""

    path: Path
    one: np.ndarray | None = field(init=False, default=None)
    _doubted: bool = field(init=False, default=False)

    def __post_init__(self) -> None:
        """Raises InputError for a file that is none."""
        if not self.path.is_dir():
            self.one = self._read(self.path)

    def __call__(self, frame: FrameFile) -> np.ndarray:
        """(4, 4) of a frame. Raises InputError where there is none."""
        if self.one is not None:
            return self.one
        for suffix in SUFFIXES:
            if (file := self.path / f"{frame.path.stem}{suffix}").is_file():
                return self._read(file)
        raise InputError(f"{self.path}: no {NAME} for {frame.path} in it; name a file like the frame, .txt or .json")

    def _read(self, file: Path) -> np.ndarray:
        """With a line on stderr at the first that seems to be in other units."""
        T_world_camera = read_transform(file, NAME)
        for doubt in [] if self._doubted else unit_doubts(T_world_camera):
            print(f"omad: warning: {file}: {doubt}", file=sys.stderr)
            self._doubted = True
        return T_world_camera
