"""How much an input may ask of this machine. What goes beyond is refused before it is unpacked.

Files come from strangers: a few bytes may unpack to gigabytes. Whoever needs more says so in the environment, by name:
``OMAD_LIMITS="image_pixels=2e8,cloud_points=5e7"``.
"""

import math
import os
from contextlib import suppress
from dataclasses import dataclass, fields
from functools import cache
from typing import Self

from .errors import InputError

VARIABLE = "OMAD_LIMITS"
BEYOND = 2**62
"""What no limit can be raised to."""


@dataclass(frozen=True)
class Limits:
    """Largest sizes; each can be raised (or lowered) by its name."""

    image_pixels: int = 50_000_000
    """Width times height of a depth image, a mask, a picture."""
    image_side: int = 30_000
    """Pixels, and of cameras."""
    cloud_points: int = 20_000_000
    """Points of a cloud."""
    cloud_text_bytes: int = 150_000_000
    """A cloud written as text."""
    text_bytes: int = 32_000_000
    """A JSON, TOML, YAML, URDF or CSV file."""
    mask_text_bytes: int = 4_000_000
    """A mask as JSON that is sent, or lies in a table; one takes some thirty times as much memory."""
    camera_bytes: int = 1_000_000
    """A camera's file: intrinsics, lens, place."""
    data_bytes: int = 500_000_000
    """A binary file (array, cloud, mesh, index, network), packed and unpacked."""
    sent_bytes: int = 100_000_000
    """An NPZ that is sent, or lies in a table, unpacked: as much as the largest image of 16 bits."""
    mesh_faces: int = 2_000_000
    """Triangles of a mesh, and vertices."""
    links: int = 1_000
    """Links of a URDF."""
    parts: int = 64
    """Parts of a category."""
    keypoints: int = 4_096
    """Keypoints of a category, all parts together."""
    basis_size: int = 256
    """Numbers of shape."""
    points: int = 65_536
    """Points that a network looks at, and width of each of its layers."""
    catalogue: int = 20_000_000
    """Entries of an index."""
    objects: int = 100_000
    """Objects that are generated, or trained on, at once."""
    views: int = 10_000_000
    """Views of a rendered folder, or of a measurement."""

    @classmethod
    def of_text(cls, text: str) -> Self:
        """The usual ones, but for those named: ``image_pixels=2e8,links=2000``. Raises InputError."""
        known, given = {field.name for field in fields(cls)}, dict[str, int]()
        for word in filter(None, (word.strip() for word in text.split(","))):
            name, _, number = word.partition("=")
            value = 0.0
            with suppress(ValueError):
                value = float(number)
            if name not in known or not 1 <= value < BEYOND:
                raise InputError(f"{VARIABLE}: {word!r} is no limit; give name=number with {', '.join(sorted(known))}")
            given[name] = int(value)
        return cls(**given)


@cache
def limits() -> Limits:
    """Those of this process: what ``OMAD_LIMITS`` said when they were first asked for."""
    return Limits.of_text(os.environ.get(VARIABLE, ""))


def check_limit(name: str, size: float, what: str) -> None:
    """Raises InputError where ``size`` is beyond the limit called ``name``; ``what`` is so large, as "the image"."""
    most = getattr(limits(), name)
    if size > most:
        cure = f", or raise the limit with {VARIABLE}={name}={math.ceil(size)}" if size < BEYOND else ""
        size = min(size, 1e300)  # what is beyond cannot be written as a float
        said = f"{what} has {size:.6g}, more than {most} ({name.replace('_', ' ')})"
        raise InputError(f"{said}; give a smaller one{cure}")
