"""Category specs. A category is data: no code elsewhere asks for its name. What cannot be is refused where it is made:
a ValueError that begins with the field, as "keypoints: is 0; give ..."."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from omad.common.decode import within
from omad.common.limits import check_limit
from omad.geometry.joint_kinds import JointType, Motion, motion_of
from omad.geometry.kinematics import KinematicTree

from .builtin import AUTO
from .pose import mirrored_axes

RestRule = Literal["closed", "perpendicular", "tips together", "reaching", "zero"]
"""How geometry tells the rest state: the whole's box is smallest, the child is a quarter turn from lying flat on its
parent, two long parts that cross at the joint point the same way, the child reaches just where ``reach`` says, or it is
the source's own zero."""
SLIDING_REST_RULES: tuple[RestRule, ...] = ("closed", "zero")
"""Those that make sense for a joint that does not turn."""
LARGEST = 1e4
"""Of a length in metres, an angle, a number of units."""
SMALLEST_UNIT, LARGEST_UNIT = 1e-3, 10.0
"""Metres that a category unit, about the radius of its objects, may have: beyond are lengths in another unit."""
ALIKE = 1e-6
"""Axes and limits (radians or metres) that differ by less are the same."""
LONGEST_NAME = 100
LONGEST_SIDE = 2.0
"""Of a part, as a share of the object's diagonal; 1 is the most that can be."""
CAMERA, WORLD = "camera_optical_frame", "world"
"""Frames that written objects hang on, and so the names of no part."""


@dataclass(frozen=True)
class PartSpec:
    """One part of a category."""

    name: str
    """A word."""
    keypoints: int
    """Number of keypoints on the part; even where the part is its own mirror image."""
    mirror: int | None = None
    """Index of the part that is this one's image in the plane x = 0 (itself, another, or None: no mirror)."""
    aliases: tuple[str, ...] = ()
    """Link and semantic names that foreign models use for this part; matched as lower-case substrings."""
    sides: tuple[tuple[float, float], tuple[float, float], tuple[float, float]] | None = None
    """Least and largest extent along x, y and z at rest, as shares of the whole object's diagonal: a foreign model
    outside of them is of another kind."""

    def __post_init__(self) -> None:
        _check_name(self.name)
        if self.keypoints < 1:
            raise ValueError(f"keypoints: is {self.keypoints}; give a whole number from 1")
        if any(not 0 <= least < most <= LONGEST_SIDE for least, most in self.sides or ()):
            raise ValueError(f"sides: is {self.sides}; give ranges from 0 to 1, the least first")


@dataclass(frozen=True)
class JointSpec:
    """Joint that links part ``index + 1`` to ``parent``; ``index`` is its place in ``Category.joints``."""

    name: str
    """A word."""
    type: JointType
    """What it does: turns, slides, or both."""
    parent: int
    """Index of the part that it hangs on."""
    axis: tuple[float, float, float]
    """Direction in canonical space, signed as the category's state is."""
    limits: tuple[float, float]
    """Radians, or category units where the state is a length. Used where an object states none, and to draw views."""
    reach: tuple[float, float, float] | None = None
    """Roughly where the child reaches from the joint at rest: pivot to box centre. Tells foreign models' axes apart."""
    side: tuple[float, float, float] | None = None
    """Roughly where the child lies from its parent at rest: box centre to box centre."""
    pitch: float | None = None
    """Metres a turn that a joint which turns and slides advances along its axis, signed; no other joint has one."""
    rest: RestRule = "closed"
    """How geometry tells state 0."""
    at_most: int | None = None
    """Index of a joint before it whose state its own does not exceed, as its part would go through another one."""

    def __post_init__(self) -> None:
        for field, direction in (("axis", self.axis), ("reach", self.reach), ("side", self.side)):
            if direction is not None and not 1e-6 <= max(map(abs, direction)) <= LARGEST:
                raise ValueError(f"{field}: is {direction}, which has no direction; give another one")
        _check_name(self.name)
        if not self.limits[0] < self.limits[1]:
            raise ValueError(f"limits: {list(self.limits)} is an empty range; give the low end first, and a higher one")
        for field, numbers in (("limits", self.limits), ("pitch", (self.pitch or 0.0,))):
            if max(map(abs, numbers)) > LARGEST:
                raise ValueError(f"{field}: goes beyond {LARGEST:g}, which no joint does; check its unit")
        try:
            turns = self.motion.turns
        except ValueError as error:
            raise ValueError(f"pitch: is {self.pitch}, but {error}; give metres a turn") from error
        rules = get_args(RestRule) if turns else SLIDING_REST_RULES
        if self.rest not in rules:
            raise ValueError(f"rest: is {self.rest!r}; give {' or '.join(rules)}")
        if self.rest == "reaching" and self.reach is None:
            raise ValueError("rest: is 'reaching', of a part without a reach; give that, too")

    @property
    def motion(self) -> Motion:
        """In metres."""
        return motion_of(self.type, self.pitch)


@dataclass(frozen=True)
class ViewRange:
    """How standard views look at a category, in radians (see ``omad.data.rendering.viewpoints``)."""

    azimuth: float = math.pi / 2
    """Uniform within plus or minus this of the front."""
    elevation: tuple[float, float] = (math.radians(10), math.radians(70))
    """Uniform from the lowest to the highest, above the horizon."""
    roll: float = math.radians(15)
    """Uniform within plus or minus this of level."""

    def __post_init__(self) -> None:
        if not 0 < self.azimuth <= math.pi:
            raise ValueError(f"azimuth: is {math.degrees(self.azimuth):g}; give degrees above 0, up to 180")
        low, high = map(math.degrees, self.elevation)
        if not -90 <= low <= high <= 90:
            raise ValueError(f"elevation: is {low:g} to {high:g}; stay within -90 and 90 degrees, the low end first")
        if not 0 <= self.roll <= math.pi:
            raise ValueError(f"roll: is {math.degrees(self.roll):g}; give degrees from 0 to 180")


@dataclass(frozen=True)
class Category:
    """What the parts and joints of a kind of object are called and how they are signed."""

    name: str
    """A word, which files and commands use."""
    metres_per_unit: float
    """One category unit in metres: about the radius of an object's bounding sphere."""
    parts: tuple[PartSpec, ...]
    """The base first."""
    joints: tuple[JointSpec, ...]
    """Joint j moves part j + 1."""
    views: ViewRange = ViewRange()
    """From where such objects are seen."""
    basis_size: int = 10
    """Numbers that beta has."""
    swap_symmetry: bool = False
    """The object turned half about z with its two parts swapped is the same object: either labelling is right."""
    either_hand: bool = False
    """The mirror image of such an object is one too, as of a door hinged on the other side. Parts, joints and whatever
    is learned are of the hand that the spec describes; objects of the other hand are taken as their mirror image."""
    source_names: tuple[str, ...] = ()
    """What data sets call the category besides ``name``: a model that says it is of another one is refused."""

    def __post_init__(self) -> None:
        _check_name(self.name)
        if self.name == AUTO:
            raise ValueError(f"name: {AUTO} stands for any category; choose another")
        check_unit(self.metres_per_unit)
        for field, size, limit in (
            ("parts", len(self.parts), "parts"),
            ("parts: keypoints", self.num_keypoints, "keypoints"),
            ("basis_size", self.basis_size, "basis_size"),
        ):
            with within(f"{field}: "):
                check_limit(limit, size, "this category")
        if not self.joints or len(self.parts) != len(self.joints) + 1:
            raise ValueError("parts: needs a base and at least one part that moves, each by a joint of its own")
        if not 1 <= self.basis_size <= 3 * self.num_keypoints:
            raise ValueError(f"basis_size: is {self.basis_size}; give a whole number from 1 to three a keypoint")
        for index, part in enumerate(self.parts):
            with within(f"parts[{index}]."):
                _check_unique(part, self.parts)
                if part.name in (CAMERA, WORLD):
                    raise ValueError(f"name: {part.name} is what the object hangs on in a robot's file; rename it")
                self._check_mirror(index, part)
        for index, joint in enumerate(self.joints):
            with within(f"parts[{index + 1}].joint."):
                _check_unique(joint, self.joints)
                if not 0 <= joint.parent <= index:
                    raise ValueError(f"parent: is part {joint.parent}; name one before its child")
                self._check_at_most(index, joint)
        if self.either_hand and any(joint.pitch for joint in self.joints):
            raise ValueError("either_hand: a thread in a mirror is another thread; remove it")
        if self.swap_symmetry and len(self.parts) != 2:
            raise ValueError(f"swap_symmetry: is for two parts, not {len(self.parts)}; remove it")

    def _check_mirror(self, index: int, part: PartSpec) -> None:
        """A mirror image has the same keypoints, and is mirrored back; halves of a part's own need an even number."""
        if part.mirror is None:
            return
        if not 0 <= part.mirror < len(self.parts):
            raise ValueError(f"mirror: is part {part.mirror}; give one of the {len(self.parts)}")
        other = self.parts[part.mirror]
        if other.mirror != index:
            raise ValueError(f"mirror: is {other.name!r}, whose own mirror is another one; name them in each other")
        if other.keypoints != part.keypoints:
            raise ValueError(f"keypoints: differ from those of its mirror {other.name!r}")
        if part.mirror == index and part.keypoints % 2:
            raise ValueError(f"keypoints: are {part.keypoints} on a part that is its own mirror; use an even number")

    def _check_at_most(self, index: int, joint: JointSpec) -> None:
        """States are compared, so both are angles or both lengths."""
        if joint.at_most is None:
            return
        if not 0 <= joint.at_most < index:
            raise ValueError(f"at_most: is joint {joint.at_most}; name one before it")
        other = self.joints[joint.at_most]
        if other.motion.turns != joint.motion.turns:
            raise ValueError(f"at_most: {other.name!r} does not move as this joint does; angles compare with angles")

    @property
    def tree(self) -> KinematicTree:
        """In category units."""
        return self.metric_tree.scaled(1 / self.metres_per_unit)

    @property
    def metric_tree(self) -> KinematicTree:
        """In metres."""
        return KinematicTree(tuple(j.parent for j in self.joints), tuple(j.motion for j in self.joints))

    @property
    def turning(self) -> tuple[bool, ...]:
        """Per joint, whether its state is an angle and its axis has a place."""
        return self.metric_tree.turning

    @property
    def state_units(self) -> np.ndarray:
        """(J,) factors from states in category units to states in metres: 1 for angles."""
        return np.array([joint.motion.state_unit(self.metres_per_unit) for joint in self.joints])

    @property
    def axes(self) -> np.ndarray:
        """(J, 3) as the spec has them, unit vectors of the canonical frame."""
        axes = np.array([joint.axis for joint in self.joints], dtype=np.float64).reshape(-1, 3)
        return axes / np.linalg.norm(axes, axis=1, keepdims=True)

    @property
    def limits(self) -> np.ndarray:
        """(J, 2) radians or category units."""
        return np.array([joint.limits for joint in self.joints], dtype=np.float64).reshape(-1, 2)

    @property
    def metric_limits(self) -> np.ndarray:
        """(J, 2) radians or metres."""
        return self.limits * self.state_units[:, None]

    def tangent_units(self, beta_size: int) -> np.ndarray:
        """(6 + J + D,) factors from a step of the unknowns (turn, move, joint states, beta of ``beta_size`` D) in
        category units to one in radians and metres."""
        place = [1.0] * 3 + [self.metres_per_unit] * 3
        return np.concatenate([place, self.state_units, np.ones(beta_size)])

    @property
    def num_keypoints(self) -> int:
        """Of all parts together."""
        return sum(part.keypoints for part in self.parts)

    @property
    def part_of_keypoint(self) -> tuple[int, ...]:
        """Keypoints are grouped by part, base first."""
        return tuple(index for index, part in enumerate(self.parts) for _ in range(part.keypoints))

    @property
    def part_images(self) -> tuple[int, ...] | None:
        """Whose image in the plane x = 0 each part is, where the images hang on each other, and move, as the parts do;
        None where they do not, or there are none: a thread in a mirror is another thread."""
        images = tuple(part.mirror for part in self.parts if part.mirror is not None)
        if len(images) < len(self.parts) or images[0] != 0 or any(joint.pitch for joint in self.joints):
            return None
        rows, joints = zip(images[1:], self.joints, strict=True), np.array(images[1:]) - 1
        if any(images[joint.parent] != self.joints[image - 1].parent for image, joint in rows):
            return None
        turning, limits, signs = np.array(self.turning), self.metric_limits, self.signs_of_images(joints)
        moved = np.sort(signs[:, None] * limits[joints], 1)
        alike = np.allclose(np.abs(signs), 1, atol=ALIKE) and np.allclose(moved, limits, atol=ALIKE)
        return images if alike and (turning[joints] == turning).all() else None

    def signs_of_images(self, joints: np.ndarray) -> np.ndarray:
        """(J,) of the states in the plane x = 0 of joints whose images are ``joints`` (J,): 1 or -1 where axes are."""
        return (mirrored_axes(self.axes, self.turning) * self.axes[joints]).sum(1)


def check_unit(metres_per_unit: float) -> None:
    """Raises ValueError for a length that nothing can be measured in."""
    if not 0 < metres_per_unit < math.inf:
        raise ValueError(f"metres_per_unit: is {metres_per_unit}; give a number above 0")
    if not SMALLEST_UNIT <= metres_per_unit <= LARGEST_UNIT:
        cure = f"give metres, from {SMALLEST_UNIT:g} to {LARGEST_UNIT:g}: about the radius of such an object"
        raise ValueError(f"metres_per_unit: is {metres_per_unit:g}; {cure}")


def _check_name(name: str) -> None:
    """Names become those of files and links, and stand in tables and pages."""
    odd = not name.isprintable() or {*name} & {*"/\\<>&\"'`|"} or name[:1] in {*"=+-@"} or name in (".", "..")
    if odd or not 0 < len(name) <= LONGEST_NAME:
        raise ValueError(f"name: is {name[:LONGEST_NAME]!r}; give a short one of letters, digits and _")


def _check_unique(named: PartSpec | JointSpec, among: Sequence[PartSpec | JointSpec]) -> None:
    if [each.name for each in among].count(named.name) > 1:
        raise ValueError(f"name: {named.name!r} stands twice; rename one")
