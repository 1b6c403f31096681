"""What turns signals into numbers to rely on: how far off a joint state may be, and whether an answer is right.

A category's is fitted to views of objects that its network has not seen (``omad train confidence``), and lies in the
checkpoint folder beside the network as ``confidence.json``.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from hashlib import sha256
from pathlib import Path
from statistics import NormalDist
from typing import Self

import numpy as np

from omad.common.decode import decode
from omad.common.errors import InputError
from omad.common.files import write_json
from omad.common.incoming import read_sealed, sealed
from omad.objects.category import Category

from .perceptron import Perceptron
from .signals import IMAGE, JOINT, WITHOUT_FRONT, WITHOUT_SURFACE, Signals

FILE, WEIGHTS = "confidence.json", "model.safetensors"
FORMAT = 1
RIGHT_ANGLE, RIGHT_SHARE = float(np.radians(10)), 0.1
"""An answer is right where no joint state is farther off: radians, and a share of the object's diagonal."""
SHARED = 0.5
"""``Confidence.shared`` where nothing is known of it: that of a usual category."""
CURE = "run omad train confidence, or delete the file"


def right_within(category: Category, diagonal: float) -> np.ndarray:
    """(J,) radians or metres that a joint state of a right answer may be off, of an object of such a ``diagonal``."""
    return np.where(category.turning, RIGHT_ANGLE, RIGHT_SHARE * diagonal)


def deviations(level: float) -> float:
    """Standard deviations to both sides of its mean that hold a share ``level`` of a normal distribution."""
    return -NormalDist().inv_cdf((1 - level) / 2)


MEDIAN, UPPER = deviations(0.5), deviations(0.9)


@dataclass(frozen=True)
class FittedTo:
    """Views that a confidence was fitted to."""

    source: str
    views: int
    version: str
    """Of omad."""


@dataclass(frozen=True)
class Confidence:
    """Of one category's network."""

    category: str
    """Its name."""
    image: tuple[str, ...]
    """Names of the signals of an estimate, the first of ``IMAGE`` ..."""
    joint: tuple[str, ...]
    """... and of each joint, in their order."""
    errors: Perceptron
    """From the signals of image and joint, and which joint it is (J zeros but for a one), to the logarithm of its
    state's median error (category units), and to that of the 90th percentile's ratio to it before a softplus."""
    right: Perceptron
    """From the signals of image and all joints to the log-odds of a right answer."""
    fitted_to: FittedTo
    """What it was learned from."""
    hand: tuple[float, ...] = ()
    """Of a category whose objects may be of either hand: what ``either_hand.odds`` takes."""
    shared: float = SHARED
    """Correlation of the errors of joint states in views of one object from quite different sides: what is of the
    object, and no further view tells."""
    base: tuple[float, float] = (1.0, 1.0)
    """How many times as far as by least squares the base is turned and moved away from where it is, but for
    ``widening``."""

    def spreads(self, signals: Signals, category: Category) -> tuple[np.ndarray, np.ndarray]:
        """``state_std`` (B, J), radians or metres, and ``tail`` (B, J) of ``JointEstimate``."""
        median, ratio = np.moveaxis(self.errors(joint_inputs(signals.known_by(self.image))), -1, 0)
        tail = np.logaddexp(0, ratio) / np.log(UPPER / MEDIAN)
        span = np.ptp(category.metric_limits, axis=1)
        return np.minimum(np.exp(median) * MEDIAN**-tail * category.state_units, span), tail

    def base_spreads(self, base: np.ndarray, least: np.ndarray, told: np.ndarray) -> np.ndarray:
        """``Estimate.base_std`` (B, 6), of that by least squares, ``base`` (B, 6), and of joint states' deviations
        (B, J), by least squares and as ``spreads`` has them."""
        return base * widening(least, told)[:, None] * np.repeat(self.base, 3)

    def probabilities(self, signals: Signals) -> np.ndarray:
        """(B,) that an answer is right."""
        return 1 / (1 + np.exp(-self.right(image_inputs(signals.known_by(self.image)))[:, 0]))

    def save(self, folder: Path) -> None:
        """Put it into a checkpoint folder, whole or not at all. Raises InputError."""
        record = {"format": FORMAT, "weights": _identity(folder), **asdict(self)}
        write_json(folder / FILE, sealed(record))

    @classmethod
    def load(cls, folder: Path, category: Category) -> Self | None:
        """That of a checkpoint folder; None where it has none. Raises InputError for a damaged file, and for one of
        other weights, another category or version."""
        path = folder / FILE
        if not path.exists():
            return None
        record = read_sealed(path, CURE)
        if not isinstance(record, dict) or record.pop("format", None) != FORMAT:
            raise InputError(f"{path}: not a confidence of format {FORMAT}; {CURE}")
        if record.pop("weights", None) != _identity(folder):
            raise InputError(f"{path}: was fitted to other weights than those beside it; {CURE}")
        try:
            found = decode(cls, record)
        except ValueError as error:
            raise InputError(f"{path}: {error}; {CURE}") from error
        joints, image = len(category.joints), len(found.image)
        sizes = len(found.errors.mean), len(found.errors.straight), len(found.right.mean), len(found.right.straight)
        if not 0 <= found.shared <= 1:
            raise InputError(f"{path}: shared is {found.shared}, which is no share of one; {CURE}")
        if not min(found.base) > 0:
            raise InputError(f"{path}: base is {found.base}, of which both must be above zero; {CURE}")
        if found.category != category.name:
            raise InputError(f"{path}: is for {found.category}, not for {category.name}; {CURE}")
        if found.image not in (WITHOUT_FRONT, WITHOUT_SURFACE, IMAGE) or found.joint != JOINT or sizes != (
            image + len(JOINT) + joints, 2, image + joints * len(JOINT), 1
        ):  # fmt: skip
            raise InputError(f"{path}: field image, joint, errors or right: of another version; {CURE}")
        return found


def widening(least: np.ndarray, told: np.ndarray) -> np.ndarray:
    """(B,) how much wider the base's deviations are where the joint states' are ``told`` (B, J) to be wider than by
    least squares, ``least`` (B, J): by the root of their ratio. States that were known tell nothing."""
    counts = (least > 0) & (told > 0)
    logs = np.log(np.where(counts, told, 1.0) / np.where(counts, least, 1.0))
    return np.exp(logs.sum(1) / np.maximum(counts.sum(1), 1) / 2)


def _identity(folder: Path) -> str:
    """Tells the network of a checkpoint folder from others."""
    return sha256((folder / WEIGHTS).read_bytes()).hexdigest()[:16]


def joint_inputs(signals: Signals) -> np.ndarray:
    """(B, J, N) what ``Confidence.errors`` takes."""
    batch, joints = signals.joint.shape[:2]
    image = np.repeat(signals.image[:, None], joints, 1)
    which = np.broadcast_to(np.eye(joints), (batch, joints, joints))
    return np.concatenate([image, signals.joint, which], 2)


def image_inputs(signals: Signals) -> np.ndarray:
    """(B, N) what ``Confidence.right`` takes."""
    return np.concatenate([signals.image, signals.joint.reshape(len(signals.joint), -1)], 1)
