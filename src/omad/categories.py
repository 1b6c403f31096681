"""Category specs. A category is data: no code elsewhere asks for its name."""

from __future__ import annotations

import math
from dataclasses import dataclass

from .kinematics import JointType, KinematicTree


@dataclass(frozen=True)
class PartSpec:
    """One part of a category."""

    name: str
    keypoints: int
    """Number of keypoints on the part; even where the part is its own mirror image."""
    mirror: int | None = None
    """Index of the part that is this one's image in the plane x = 0 (itself, another, or None: no mirror)."""
    aliases: tuple[str, ...] = ()
    """Link and semantic names that foreign models use for this part; matched as lower-case substrings."""
    sides: tuple[tuple[float, float], tuple[float, float], tuple[float, float]] | None = None
    """Least and largest extent along x, y and z at rest, as shares of the whole object's diagonal: a foreign model
    outside of them is of another kind."""


@dataclass(frozen=True)
class JointSpec:
    """Joint that links part ``index + 1`` to ``parent``; ``index`` is its place in ``Category.joints``."""

    name: str
    type: JointType
    parent: int
    axis: tuple[float, float, float]
    """Direction in canonical space, signed as the category's state is."""
    limits: tuple[float, float]
    """Radians; for a prismatic joint in category units. Used where an object states none, and to draw views."""
    reach: tuple[float, float, float] | None = None
    """Roughly where the child reaches from the joint at rest: pivot to box centre. Tells foreign models' axes apart."""
    side: tuple[float, float, float] | None = None
    """Roughly where the child lies from its parent at rest: box centre to box centre."""


@dataclass(frozen=True)
class ViewRange:
    """How standard views look at a category, in radians (see ``omad.views``)."""

    azimuth: float = math.pi / 2
    """Uniform within plus or minus this of the front."""
    elevation: tuple[float, float] = (math.radians(10), math.radians(70))
    roll: float = math.radians(15)


@dataclass(frozen=True)
class Category:
    """What the parts and joints of a kind of object are called and how they are signed."""

    name: str
    metres_per_unit: float
    """One category unit in metres: about the radius of an object's bounding sphere."""
    parts: tuple[PartSpec, ...]
    joints: tuple[JointSpec, ...]
    rest: tuple[str, ...]
    """Per joint, how geometry tells the rest state: 'closed' (box smallest), 'perpendicular' (child at 90 degrees),
    'tips together' (two long parts that cross at the joint point the same way), 'zero' (the source's own zero)."""
    views: ViewRange = ViewRange()
    basis_size: int = 10
    """Numbers that beta has."""
    swap_symmetry: bool = False
    """The object turned half about z with its two parts swapped is the same object: either labelling is right."""
    source_names: tuple[str, ...] = ()
    """What data sets call the category besides ``name``: a model that says it is of another one is refused."""

    def __post_init__(self) -> None:
        for part in self.parts:
            if part.mirror is not None and self.parts[part.mirror].keypoints != part.keypoints:
                raise ValueError(f"{self.name}: mirrored parts need equally many keypoints")
        for index, part in enumerate(self.parts):
            if part.mirror == index and part.keypoints % 2:
                raise ValueError(f"{self.name}: part {part.name} is its own mirror, so its keypoints must be even")
        if self.swap_symmetry and len(self.parts) != 2:
            raise ValueError(f"{self.name}: swap_symmetry is for two parts, not {len(self.parts)}")

    @property
    def tree(self) -> KinematicTree:
        return KinematicTree(tuple(j.parent for j in self.joints), tuple(j.type for j in self.joints))

    @property
    def revolute(self) -> tuple[bool, ...]:
        """Per joint."""
        return tuple(joint.type == "revolute" for joint in self.joints)

    @property
    def num_keypoints(self) -> int:
        return sum(part.keypoints for part in self.parts)

    @property
    def part_of_keypoint(self) -> tuple[int, ...]:
        """Keypoints are grouped by part, base first."""
        return tuple(index for index, part in enumerate(self.parts) for _ in range(part.keypoints))


LAPTOP = Category(
    name="laptop",
    metres_per_unit=0.28,
    parts=(
        PartSpec(
            "base", 12, mirror=0, aliases=("base", "bottom", "keyboard"), sides=((0.4, 1.0), (0.0, 0.25), (0.25, 0.8))
        ),
        PartSpec(
            "screen",
            12,
            mirror=1,
            aliases=("screen", "top", "lid", "display"),
            sides=((0.4, 1.0), (0.2, 0.8), (0.0, 0.25)),
        ),
    ),
    joints=(
        JointSpec(
            name="hinge",
            type="revolute",
            parent=0,
            axis=(1.0, 0.0, 0.0),
            limits=(math.radians(-80), math.radians(85)),
            reach=(0.0, 1.0, 0.0),
            side=(0.0, 1.0, -1.0),
        ),
    ),
    rest=("perpendicular",),
)

DISHWASHER = Category(
    name="dishwasher",
    metres_per_unit=0.57,
    parts=(
        PartSpec(
            "body", 12, mirror=0, aliases=("body", "cabinet", "frame"), sides=((0.2, 0.85), (0.25, 0.95), (0.2, 0.85))
        ),
        PartSpec("door", 12, mirror=1, aliases=("door",), sides=((0.2, 0.85), (0.2, 0.95), (0.0, 0.35))),
    ),
    joints=(
        JointSpec(
            name="door_hinge",
            type="revolute",
            parent=0,
            axis=(1.0, 0.0, 0.0),
            limits=(0.0, math.radians(90)),
            reach=(0.0, 1.0, 0.0),
            side=(0.0, 0.0, 1.0),
        ),
    ),
    rest=("closed",),
)

DRAWER = Category(
    name="drawer",
    metres_per_unit=0.45,
    parts=(
        PartSpec(
            "cabinet",
            12,
            mirror=0,
            aliases=("cabinet", "body", "frame", "base"),
            sides=((0.2, 0.95), (0.2, 0.95), (0.15, 0.85)),
        ),
        PartSpec("top_drawer", 8, mirror=1, aliases=("drawer",)),
        PartSpec("middle_drawer", 8, mirror=2, aliases=("drawer",)),
        PartSpec("bottom_drawer", 8, mirror=3, aliases=("drawer",)),
    ),
    joints=tuple(
        JointSpec(name, "prismatic", 0, (0.0, 0.0, 1.0), (0.0, 0.8), side=(0.0, height, 0.3))
        for name, height in (("top_slide", 1.0), ("middle_slide", 0.0), ("bottom_slide", -1.0))
    ),
    rest=("closed", "closed", "closed"),
    source_names=("StorageFurniture", "Table"),
)

EYEGLASSES = Category(
    name="eyeglasses",
    metres_per_unit=0.11,
    parts=(
        PartSpec(
            "frame",
            16,
            mirror=0,
            aliases=("frame", "glass", "body", "base", "lens"),
            sides=((0.35, 1.0), (0.05, 0.6), (0.0, 0.45)),
        ),
        PartSpec(
            "right_temple", 8, mirror=2, aliases=("leg", "temple", "arm"), sides=((0.0, 0.3), (0.0, 0.4), (0.25, 0.95))
        ),
        PartSpec(
            "left_temple", 8, mirror=1, aliases=("leg", "temple", "arm"), sides=((0.0, 0.3), (0.0, 0.4), (0.25, 0.95))
        ),
    ),
    joints=(
        JointSpec(
            name="right_hinge",
            type="revolute",
            parent=0,
            axis=(0.0, 1.0, 0.0),
            limits=(0.0, math.radians(90)),
            reach=(0.0, 0.0, -1.0),
            side=(1.0, 0.0, -1.0),
        ),
        JointSpec(
            name="left_hinge",
            type="revolute",
            parent=0,
            axis=(0.0, 1.0, 0.0),
            limits=(math.radians(-90), 0.0),
            reach=(0.0, 0.0, -1.0),
            side=(-1.0, 0.0, -1.0),
        ),
    ),
    rest=("perpendicular", "perpendicular"),
    views=ViewRange(azimuth=math.pi),
)

SCISSORS = Category(
    name="scissors",
    metres_per_unit=0.11,
    parts=(
        PartSpec(
            "blade", 12, aliases=("blade", "handle", "leg", "scissor"), sides=((0.05, 0.7), (0.0, 0.3), (0.4, 1.0))
        ),
        PartSpec(
            "other_blade",
            12,
            aliases=("blade", "handle", "leg", "scissor"),
            sides=((0.05, 0.7), (0.0, 0.3), (0.4, 1.0)),
        ),
    ),
    joints=(
        JointSpec(
            name="pivot",
            type="revolute",
            parent=0,
            axis=(0.0, 1.0, 0.0),
            limits=(math.radians(-70), 0.0),
        ),
    ),
    rest=("tips together",),
    views=ViewRange(azimuth=math.pi, elevation=(math.radians(20), math.radians(90))),
    swap_symmetry=True,
)

CATEGORIES = {category.name: category for category in (LAPTOP, EYEGLASSES, DISHWASHER, SCISSORS, DRAWER)}
