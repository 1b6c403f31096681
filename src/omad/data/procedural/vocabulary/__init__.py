"""What random objects are made of: bodies with a cavity, doors, lids, drawers, handles, stands, with room to move.

A generator of one's own takes all of it from here. Lengths are in metres, y is up, z to the front; solids are closed
and face outwards. Every function that takes ``rng`` draws its proportions from it, and nothing else from anywhere.
"""

from omad.geometry.mesh import Mesh, merge_meshes

from ..shapes import JointedParts, box, cylinder, frame, loft, points, slab, spline, sweep, taper, tube
from .cases import Case, Rect, controls, shelves, surround
from .contents import contents
from .doors import bow, fitted, fixed_fronts, leaf, liner, pivot_at_side, pressed
from .handles import Pull, handle
from .racks import rack
from .stands import feet, stand
from .trays import tray
from .vessels import Lid, Outline, lid, turned

__all__ = [
    "Case", "JointedParts", "Lid", "Mesh", "Outline", "Pull", "Rect", "bow", "box", "contents", "controls",
    "cylinder", "feet", "fitted", "fixed_fronts", "frame", "handle", "leaf", "lid", "liner", "loft", "merge_meshes",
    "pivot_at_side", "points", "pressed", "rack", "shelves", "slab", "spline", "stand", "surround", "sweep", "taper",
    "tray", "tube", "turned",
]  # fmt: skip
