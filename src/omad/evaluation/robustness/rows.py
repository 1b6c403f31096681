"""The rows of the robustness table: what is wrong with the views of each."""

import math
from dataclasses import dataclass

from omad.data.rendering.spoils.spoil import Spoil, Staging

WALL, TABLE, SHELF, CLUTTER = (Staging(place) for place in ("wall", "table", "shelf", "clutter"))


@dataclass(frozen=True)
class Row:
    """One row."""

    what: str
    """For a person."""
    spoil: Spoil = Spoil()


def _seen_from(low: float, high: float) -> Spoil:
    """Degrees above the horizon."""
    return Spoil(Staging(elevation=(math.radians(low), math.radians(high))))


CLEAN = "clean"
AS_THEY_ARE = Row("the frames as they are")
"""In place of the clean row, of images."""
ROWS: dict[str, Row] = {
    CLEAN: Row("the object alone, exact depth, standard camera"),
    "noise": Row("white noise of a small stereo camera", Spoil(noise="on")),
    "noise-double": Row("twice that noise", Spoil(noise="double")),
    "smooth-1": Row("smooth error of 1 % of the object's size", Spoil(waves=0.01)),
    "smooth-3": Row("smooth error of 3 % of the object's size", Spoil(waves=0.03)),
    "active-stereo": Row("as a RealSense D435 before a wall", Spoil(WALL, noise="active_stereo")),
    "coded-light": Row("as a RealSense SR300 before a wall", Spoil(WALL, noise="coded_light")),
    "speckle": Row("as a Kinect v1 or Structure before a wall", Spoil(WALL, noise="speckle")),
    "time-of-flight": Row("as a Kinect v2 or Azure before a wall", Spoil(WALL, noise="time_of_flight")),
    "lost-10": Row("10 % of the pixels lost in blobs", Spoil(lost=0.1)),
    "lost-50": Row("half of the pixels lost in blobs", Spoil(lost=0.5)),
    "wide-3-wall": Row("mask 3 px too wide, wall", Spoil(WALL, grown=3)),
    "wide-3-table": Row("mask 3 px too wide, table", Spoil(TABLE, grown=3)),
    "wide-3-shelf": Row("mask 3 px too wide, shelf", Spoil(SHELF, grown=3)),
    "wide-3-clutter": Row("mask 3 px too wide, among other things", Spoil(CLUTTER, grown=3)),
    "wide-6-wall": Row("mask 6 px too wide, wall", Spoil(WALL, grown=6)),
    "wide-6-table": Row("mask 6 px too wide, table", Spoil(TABLE, grown=6)),
    "narrow-3": Row("mask 3 px too narrow", Spoil(grown=-3)),
    "aside-4": Row("mask 4 px beside the object, wall", Spoil(WALL, shifted=4)),
    "patch-3": Row("a patch of wrong depth on 3 % of the pixels", Spoil(patch=0.03)),
    "hidden-25": Row("a quarter hidden by something in front", Spoil(hidden=0.25)),
    "hidden-25-rim": Row("the same, 2 px of it in the mask", Spoil(hidden=0.25, rim=2)),
    "cut-off-25": Row("a quarter beyond the image's border", Spoil(Staging(cut_off=0.25))),
    "steep": Row("from 75 to 88 degrees above", _seen_from(75, 88)),
    "below": Row("from -15 to 5 degrees above", _seen_from(-15, 5)),
    "around": Row("from all around", Spoil(Staging(all_around=True))),
    "cameras": Row("320x240 to 1280x720, focal lengths 300 to 1018 px", Spoil(Staging(any_camera=True))),
    "together": Row(
        "3 px too wide with rim, patch, a tenth each hidden and cut off, 5 % lost, smooth error, among other things",
        Spoil(Staging("clutter", cut_off=0.1), hidden=0.1, waves=0.01, patch=0.03, lost=0.05, rim=2, grown=3),
    ),
}
