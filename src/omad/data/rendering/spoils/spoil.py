"""What can be wrong with a view of an object. Every field stands alone; together they are applied in the order of the
fields, which is that of a camera: what stands there, what is measured of it, what is said to be the object."""

import math
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from omad.objects.category import ViewRange

Place = Literal["nothing", "wall", "table", "shelf", "clutter"]
"""Where the object stands. wall: before a plane that faces the camera; table: on one; shelf: between boards; clutter:
on a table before a wall, beside boxes and objects of other categories."""
Noise = Literal["off", "half", "on", "double", "active_stereo", "coded_light", "speckle", "time_of_flight"]
"""A level of ``depth_noise``, or a camera of ``sensor_noise``."""


@dataclass(frozen=True)
class Staging:
    """What needs the scene rendered anew."""

    place: Place = "nothing"
    elevation: tuple[float, float] | None = None
    """Radians above the horizon from which it is looked at; None: the category's own range."""
    all_around: bool = False
    """From behind as well, not only from where the category is usually seen."""
    any_camera: bool = False
    """A random camera of real ones' sizes and focal lengths (``scenes.random_camera``), not the standard camera."""
    cut_off: float = 0.0
    """Share of the object's pixels that lie beyond the image's border."""

    def views(self, usual: ViewRange) -> ViewRange:
        """From where it is looked at, where ``usual`` is the category's range."""
        azimuth = math.pi if self.all_around else usual.azimuth
        return replace(usual, azimuth=azimuth, elevation=self.elevation or usual.elevation)


@dataclass(frozen=True)
class Spoil:
    """Nothing is wrong by default."""

    staging: Staging = Staging()
    hidden: float = 0.0
    """Share of the object's pixels behind something that stands before it."""
    noise: Noise = "off"
    waves: float = 0.0
    """Standard deviation of a smooth depth error, as a share of the object's diagonal: 0.01 is 3 mm on 0.3 m."""
    patch: float = 0.0
    """Share of the object's pixels whose depth is wrong by 3 to 20 cm, in one patch."""
    lost: float = 0.0
    """Share of the object's pixels without measurement, in blobs."""
    rim: int = 0
    """Pixels of what hides the object that the mask takes in along their common border."""
    part_missed: bool = False
    """The mask leaves one of the parts out that show, at random."""
    grown: int = 0
    """Pixels by which the mask is too wide; too narrow where negative."""
    shifted: int = 0
    """Pixels by which the mask lies beside the object, in a random direction."""


ANY_ELEVATION = (math.radians(-15), math.radians(89))


def random_spoil(rng: np.random.Generator) -> Spoil:
    """One such as training and tests may meet: everything at random, most of it absent from most views."""

    def sometimes(probability: float, low: float, high: float) -> float:
        return float(rng.uniform(low, high)) if rng.random() < probability else 0.0

    staging = Staging(
        place=rng.choice(get_args(Place)[1:], p=(0.2, 0.25, 0.15, 0.4)).item(),
        elevation=ANY_ELEVATION if rng.random() < 0.3 else None,
        all_around=bool(rng.random() < 0.3),
        any_camera=True,
        cut_off=sometimes(0.15, 0.02, 0.3),
    )
    hidden = sometimes(0.3, 0.02, 0.35)
    return Spoil(
        staging,
        hidden=hidden,
        noise=rng.choice(get_args(Noise)).item(),
        patch=sometimes(0.2, 0.005, 0.05),
        lost=sometimes(0.3, 0.02, 0.3),
        rim=int(rng.integers(4)) if hidden else 0,
        grown=int(rng.integers(-3, 7)) if rng.random() < 0.6 else 0,
        shifted=int(rng.integers(1, 5)) if rng.random() < 0.2 else 0,
    )
