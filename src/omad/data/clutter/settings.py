"""How often, and how badly, training views are spoilt."""

import math
from dataclasses import dataclass

from omad.objects.category import ViewRange

Range = tuple[float, float]


@dataclass(frozen=True)
class Clutter:
    """Shares are of the views that are spoilt at all; each spoil is drawn by itself, so that they come together.
    Pixels are those of the standard camera, lengths in category units unless they say otherwise."""

    clean: float = 0.2
    """Share of views that nothing is done to."""
    surrounded: float = 0.55
    """Share whose mask reaches beyond the object, onto what lies behind it."""
    margin: Range = (1.0, 6.0)
    """Pixels by which it does."""
    shift: float = 4.0
    """Pixels by which half of all spoilt masks are shifted, at most, in x and in y."""
    distance: Range = (0.02, 1.0)
    """How far behind the object a wall is, as a share of the object's distance."""
    beside: float = 0.15
    """Share of walls that are something beside the object: a fifth of its distance in front or behind it, at most."""
    eroded: float = 0.5
    """Share of the views that are not surrounded whose mask stops short of the object's edge."""
    loss: Range = (0.5, 3.5)
    """Pixels by which it does."""
    flying: float = 0.3
    """Share with points between the object's edge and what is behind it."""
    patched: float = 0.45
    """Share with a patch of wrong depth."""
    patch: Range = (0.005, 0.08)
    """Its share of the object's picture."""
    wrong: Range = (0.08, 0.8)
    """How far it is off."""
    occluded: float = 0.7
    """Share with something in front: a rectangle, a bar or an edge beyond which nothing is seen."""
    rim: float = 0.6
    """Share of those where its rim, seldom all of it, is left in the mask."""
    cut: float = 0.4
    """Share that the image border cuts through; less than half of the object is cut off."""
    blobs: float = 0.2
    """Share with large blobs without measurement."""
    correlated: float = 0.35
    """Share whose depth has noise that is alike in neighbouring pixels."""
    correlation: Range = (8.0, 20.0)
    """Pixels over which it is."""
    amplitude: float = 0.035
    """Its standard deviation at most: 9 mm on an object of 0.3 m."""
    around: float = 0.25
    """Share of spoilt views from where standard views do not look: from all around, above and below, near and far."""
    views: ViewRange = ViewRange(math.pi, (math.radians(-15), math.radians(89)), math.radians(30))
    """Where these look from."""
    span: Range = (0.2, 0.95)
    """Share of the image height that the object's bounding sphere then covers."""
    shut: float = 0.1
    """Share of all views with all joints at a limit: two in three of them where they are at rest, or nearer to it."""
    resized: float = 0.3
    """Share of all views with an object of another size."""
    size: Range = (0.7, 1.4)
    """By which factor."""
