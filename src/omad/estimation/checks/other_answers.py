"""What other answers of its category to the same observation say against one."""

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from omad.objects.sizes import ALIKE, WrongScale
from omad.sensing.observation import Observation

from ..estimate import Estimate
from ..known import Known
from .check import Check

AsksAgain = Callable[[Observation, Known], Estimate]

FOCAL_LENGTHS = (0.5, 2 / 3, 0.8, 1.25, 1.5, 2.0)
"""Of the one given, which may be right instead: those of other sizes of the image."""
BETTER = 1.5
"""By how much better model and seen keypoints then fit; with the right one hardly any view of unseen objects does."""
UNNAMED = tuple(factor for alike in ALIKE.values() for factor in alike)
"""Of the depth scale, which small objects' sizes do not tell of where it is too large, and large ones' where it is too
small."""
SURE_OF_SCALE = 0.8
"""Probability from which on an answer at another scale is believed, where the one at that given is doubtful."""
CERTAIN = 0.999
"""Probabilities from which on answers are equally likely."""
TILTED, TELLING = 10.0, 0.8
"""Degrees by which objects seem to lean at most that do not (98 % of noisy views of most categories: 3 to 6), and the
probability from which on an answer is believed in that."""
LYING, IN_THE_IMAGE = 30.0, 0.4
"""Degrees beyond the roll of standard views from which on an object seems to lie on its side (3 of 1000 answers to
spoilt views of upright chests and appliances did), where at least so much of its up shows in the image."""


def scaled(seen: Observation, factor: float) -> Observation:
    """All lengths so many times as large."""
    times = np.float32(factor)
    return replace(seen, points=seen.points * times, depth=None if seen.depth is None else seen.depth * times)


def scale_doubts(
    observation: Observation,
    estimate: Estimate,
    estimator: Callable[[list[Observation]], list[Estimate]],
    depth_scale: float | None = None,
) -> list[Check]:
    """Where a doubtful answer would be a sure one at another depth scale, of those that a cloud's size may not tell of.
    ``estimator`` is asked once more, for all of ``UNNAMED`` together; ``depth_scale`` is the one that the depth was
    read with, where known."""
    if not estimate.doubtful:
        return []
    found = estimator([scaled(observation, factor) for factor in UNNAMED])
    factor, surest = max(zip(UNNAMED, found, strict=True), key=lambda each: each[1].supposed_probability)
    if surest.supposed_probability < SURE_OF_SCALE:
        return []
    scale = next(WrongScale.of(kind, depth_scale) for kind, alike in ALIKE.items() if factor in alike)
    what = f"of one {factor:g} times its size this would be a sure answer, and at its own it is not"
    return [Check("scale", f"{estimate.category.name}: {what}", scale.why, f"{scale.cure}, where that is so")]


def camera_doubts(
    observation: Observation, estimate: Estimate, estimator: Callable[[list[Observation]], list[Estimate]]
) -> list[Check]:
    """Where an object of the category fits what was seen much better with another focal length: a longer one makes it
    narrower, and as deep as before. A less likely answer has to fit better by as much as its odds are worse.
    ``estimator`` is asked once more, for all of ``FOCAL_LENGTHS`` together."""
    camera, points = observation.camera, observation.points
    if camera is None:
        return []
    views = [replace(observation, points=points / np.array([[k, k, 1]], np.float32)) for k in FOCAL_LENGTHS]
    found = estimator(views)
    residuals = np.array([one.residual for one in found])
    best = int(np.nan_to_num(residuals, nan=np.inf).argmin())
    less_likely = min(1.0, _odds(found[best]) / _odds(estimate))
    if not estimate.residual * less_likely > BETTER * residuals[best]:
        return []
    likely = f"{FOCAL_LENGTHS[best] * camera.fx:.0f}"
    times = estimate.residual / residuals[best]
    what = f"a {estimate.category.name} fits {times:.1f} times as well if the focal length"
    return [
        Check(
            "intrinsics",
            f"{what} is about {likely} instead of {camera.fx:.0f} pixels",
            "the intrinsics may be those of another size of the image, or of another camera",
            f"give those of the depth image at {camera.width}x{camera.height}",
            grave=True,
        )
    ]


def gravity_doubts(
    observation: Observation, estimate: Estimate, known: Known, estimator: AsksAgain, alone: bool = True
) -> list[Check]:
    """Where the object seems to stand otherwise than the ``known`` gravity says; ``estimator`` is asked once more,
    without it, and of an observation ``alone`` by a rolled camera also for what a level one would see: an answer no
    less likely counts more. Or where gravity is not known, and the object, of a kind that stands, seems to lie."""
    if known.gravity is None:
        return list(_lying_doubts(estimate))
    unknown, up = replace(known, gravity=None), estimate.T_camera_base[:3, 1]
    free = estimator(observation, unknown)
    off = np.degrees(np.arccos(np.clip(up @ free.T_camera_base[:3, 1], -1, 1)))
    if off <= TILTED or free.supposed_probability < TELLING:
        return []
    turn = known.level_turn()
    if alone and not np.array_equal(turn, np.eye(3)):
        level = estimator(known.as_level(observation), unknown)
        if up @ turn @ level.T_camera_base[:3, 1] >= np.cos(np.radians(TILTED)) and _odds(level) >= _odds(free):
            return []
    return [
        Check(
            "gravity",
            f"without the gravity that was given the {estimate.category.name} stands {off:.0f} degrees otherwise",
            "the direction may be another one in the camera's frame, or the object does not stand upright",
            "give the direction in which things fall, x right, y down, z forward, or leave it out; T_world_camera "
            "takes from the camera to the world",
            grave=True,
        )
    ]


def _lying_doubts(estimate: Estimate) -> Iterator[Check]:
    category, up = estimate.category, estimate.T_camera_base[:3, 1]
    leaning = float(np.degrees(np.arctan2(abs(up[0]), -up[1])))
    if np.hypot(up[0], up[1]) > IN_THE_IMAGE and leaning > np.degrees(category.views.roll) + LYING:
        yield Check(
            "gravity",
            f"in the image the {category.name} leans by {leaning:.0f} degrees, and most stand upright",
            "a side was taken for the top, or the camera was turned, and then more answers are wrong",
            "give gravity (--gravity), or turn the image upright",
        )


def _odds(estimate: Estimate) -> float:
    probability = float(np.clip(estimate.supposed_probability, 1 - CERTAIN, CERTAIN))
    return probability / (1 - probability)
