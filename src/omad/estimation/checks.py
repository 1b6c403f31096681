"""What to look at where a result is doubtful: each item says what is wrong, why that may be, and what to do."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from omad.common.errors import InputError
from omad.geometry.camera import times_too_large
from omad.geometry.rigid import box
from omad.model.surfaces.agreement import Agreement
from omad.objects.category import Category
from omad.objects.sizes import is_of_size, usual_size, wrong_scale
from omad.sensing.cutting.not_depth import ENOUGH, Z_BUFFER, NotDepth, may_be_z_buffer, what_else
from omad.sensing.observation import Observation

from .confidence.signals import cut_off
from .estimate import Estimate, chance
from .evidence import explanation
from .known import Known

AsksAgain = Callable[[Observation, Known], Estimate]

HIGH_KEYPOINT_ERROR = 0.07
"""Expected keypoint error (geometric mean, category units; 0.03 is usual) above which the network is not to be
trusted."""
FEW_POINTS = 500
"""Standard views, which networks are trained on, have at least so many."""
HIGH_RESIDUAL = 0.07
"""RMS distance of model and seen keypoints in category units."""
STRAY = 0.01
"""Share of a cloud's points, at either end, that are no sign of its size: of what stands on a table single pixels of
the mask's edge show the floor behind it."""
SAMPLED = 10_000
"""Points at most, of which it is told."""
FOCAL_LENGTHS = (0.5, 2 / 3, 0.8, 1.25, 1.5, 2.0)
"""Of the one given, which may be right instead: those of other sizes of the image."""
BETTER = 1.5
"""By how much better model and seen keypoints then fit; with the right one hardly any view of unseen objects does."""
CERTAIN = 0.999
"""Probabilities from which on answers are equally likely."""
UNEXPLAINED = 0.25
"""Share of the pixels of object and surface where the one is where the other is, 0.7 in a usual view, below which they
are of two things."""
RARELY = 0.06
"""Share of answers that are right where the surface that was fitted to the image stays below it, too: two of 33 to
spoilt views of unseen objects and of other things."""
HALF_EXPLAINED = 0.5
"""That of a fitted surface of which nothing is said."""
TILTED, TELLING = 10.0, 0.8
"""Degrees by which objects seem to lean at most that do not (98 % of noisy views of most categories: 3 to 6), and the
probability from which on an answer is believed in that."""
LYING, IN_THE_IMAGE = 30.0, 0.4
"""Degrees beyond the roll of standard views from which on an object seems to lie on its side (3 of 1000 answers to
spoilt views of upright chests and appliances did), where at least so much of its up shows in the image."""
SURE_OF_HAND = 0.75
"""Of views whose hand is told less surely, one in three is taken for its mirror image; of all others one in fifty."""
SURROUNDED = 0.1
"""Share of the image from which on what is seen beside the object tells of the camera."""
HARDLY_SEEN = 0.02
"""Share of the object's points below which a part hardly shows. In views that hide a quarter or cut it off, one part in
ten does, and its joint state is five to ten times as far off as the others."""
CUT_OFF = 0.1
"""Pixels at one border of the image from which on the object runs out of it, as a share of its width in pixels."""


@dataclass(frozen=True)
class Check:
    """One item."""

    name: str
    """One word, the same for every such check."""
    what: str
    """What is unusual, with numbers."""
    why: str
    """What it may come from."""
    cure: str
    """What to do."""
    grave: bool = False
    """Answers of which this is said are hardly ever right (``RARELY``)."""

    def __str__(self) -> str:
        return f"{self.name}: {self.what}: {self.why}; {self.cure}"

    def to_dict(self) -> dict[str, str]:
        """For JSON: what a person reads. How grave it is, the probability says."""
        return {"name": self.name, "what": self.what, "why": self.why, "cure": self.cure}


def doubts(observation: Observation, estimate: Estimate, depth_scale: float | None = None) -> list[Check]:
    """What is doubtful of an estimate; ``depth_scale`` is the one that the depth was read with, where known. Raises
    InputError where an estimate comes first."""
    if isinstance(observation, Estimate):
        raise InputError("doubts: was given the estimate first; give doubts(observation, estimate)")
    category = estimate.category
    found = [
        *size_doubts(observation, category, depth_scale),
        *depth_doubts(observation),
        *scaled_doubts(observation),
        *_view_doubts(observation),
        *_fit_doubts(estimate),
        *network_doubts(estimate.keypoint_std, category),
        *part_doubts(estimate.labelled.shares, category),
        *hand_doubts(estimate.hand_probability),
        *_surface_doubts(observation, estimate),
    ]
    return found or list(_nothing_else(estimate))


def is_doubtful(estimate: Estimate, found: Sequence[Check]) -> bool:
    """Whether an answer is rather wrong than right: by its probability; where it has none, if something was ``found``
    to be doubtful."""
    return bool(found) if estimate.doubtful is None else estimate.doubtful


def believed(estimate: Estimate, found: Sequence[Check]) -> Estimate:
    """The estimate with no higher a probability than what was ``found`` leaves it."""
    return no_surer(estimate, RARELY) if any(check.grave for check in found) else estimate


def warned(estimate: Estimate, found: Sequence[Check]) -> Estimate:
    """The estimate with what was ``found`` among its warnings, and no surer than that leaves it."""
    if not found:
        return estimate
    return replace(believed(estimate, found), warnings=(*estimate.warnings, *map(str, found)))


def no_surer(estimate: Estimate, probability: float) -> Estimate:
    """The estimate, that it is right being no likelier than so."""
    if estimate.probability is None or estimate.probability <= probability:
        return estimate
    return replace(estimate, probability=probability)


def if_also(estimate: Estimate, probability: float) -> Estimate:
    """The estimate, that it is right only if something else is, too, of a ``probability``: as likely as their product,
    which keeps its word better than the smaller of both (``benchmarks/certainty/bench_auto_probability.py``)."""
    return no_surer(estimate, (estimate.probability or 0.0) * probability)


def size_doubts(observation: Observation, category: Category, depth_scale: float | None = None) -> Iterator[Check]:
    """Where the cloud cannot be an object of the category at its size: a wrong depth scale, mostly."""
    points = observation.points
    few = points[:: -(-len(points) // SAMPLED) or 1]
    ends = box(points), np.quantile(few, (STRAY, 1 - STRAY), axis=0)
    size, without_strays = (float(np.linalg.norm(high - low)) for low, high in ends)
    usual = usual_size(category)
    if any(is_of_size(each, usual) for each in (size, without_strays)):
        return
    what = f"the cloud is {size:.3g} m across, of a {category.name} about {usual:.2g} m is usual"
    depth, mask = observation.depth, observation.mask
    whole = size > usual and depth is not None and mask is not None and mask.sum() >= (depth > 0).sum()
    cut_out = "cut the object out with --mask, --box or --segment plane"
    if (scale := wrong_scale(size, usual, depth_scale)) is None:
        why, cure = "the object may be badly cut out", "look at mask, box and depth image"
        if whole:
            why, cure = "the whole frame was taken for the object", cut_out
    else:
        why, cure = scale.why, f"{scale.cure}, or another mask where more than the object is inside"
        if whole:
            why, cure = f"{why}, or the whole frame was taken for the object", f"{scale.cure}, or {cut_out}"
    yield Check("size", what, why, cure)


def depth_doubts(observation: Observation) -> Iterator[Check]:
    """Where what is seen beside the object shows that the image does not hold depth."""
    depth, camera, mask = observation.depth, observation.camera, observation.mask
    if depth is None or camera is None or mask is None:
        return
    if may_be_z_buffer(depth):  # or was cut off at 1 m
        yield _not_depth(Z_BUFFER, grave=False)
    beside = np.flatnonzero((depth > 0) & ~mask)
    if len(beside) < SURROUNDED * depth.size:
        return
    rows, columns = np.unravel_index(beside[:: -(-len(beside) // ENOUGH)], depth.shape)
    points = camera.backproject(np.stack([columns, rows], 1), depth[rows, columns])
    if (held := what_else(points.astype(np.float32))) is not None:
        yield _not_depth(held, grave=True)


def _not_depth(held: NotDepth, grave: bool) -> Check:
    return Check("depth", held.told, held.why, held.cure, grave)


def scaled_doubts(observation: Observation) -> Iterator[Check]:
    """Where the principal point shows that the intrinsics are those of another size of the image."""
    camera = observation.camera
    if camera is None or (times := times_too_large(camera)) is None:
        return
    size = f"{camera.width}x{camera.height}"
    centre = ((k + 0.5) / times - 0.5 for k in (camera.cx, camera.cy))
    scaled = ",".join(f"{number:.6g}" for number in (camera.fx / times, camera.fy / times, *centre))
    yield Check(
        "intrinsics",
        f"the principal point is the middle of an image {times:.2g} times as large as this {size} one",
        "the intrinsics are those of another size of the image, or a corner was cut out of it",
        f"give those of the depth image at {size}: of one that was only scaled {scaled}",
        grave=True,
    )


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


def _view_doubts(observation: Observation) -> Iterator[Check]:
    count = len(observation.points)
    if count < FEW_POINTS:
        yield Check(
            "points",
            f"only {count} points are on the object, {FEW_POINTS} are usual at least",
            "it is far away, mostly hidden, dark or shiny, or the mask is too small",
            "go nearer, look from another side, or check mask and box",
        )
    if cut := [name for name, share in cut_off(observation).items() if share > CUT_OFF]:
        yield Check(
            "frame",
            f"the object runs out of the image ({', '.join(cut)})",
            "what lies outside is guessed from the category alone",
            "move the camera back or aim at the object; where the background is meant, cut it off with --box",
        )


def _fit_doubts(estimate: Estimate) -> Iterator[Check]:
    unit = estimate.category.metres_per_unit
    if not estimate.converged:
        yield Check(
            "convergence",
            "the fit did not converge",
            "seen keypoints and shape model contradict each other",
            "treat joint states as a guess; try another viewpoint or a better mask",
        )
    if not estimate.residual < HIGH_RESIDUAL * unit:
        yield Check(
            "residual",
            f"model and seen keypoints are {1000 * estimate.residual:.1f} mm apart,"
            f" under {1000 * HIGH_RESIDUAL * unit:.1f} mm is usual",
            "other things may be inside the mask, or the object is unlike those of the category",
            "look at estimate.html; tighten the mask, or train on such objects",
        )


def _surface_doubts(observation: Observation, estimate: Estimate) -> Iterator[Check]:
    found = explanation(observation, estimate)
    if len(observation.points) < FEW_POINTS or found.explained >= UNEXPLAINED:
        return
    if estimate.is_finite:  # takes long; most answers are explained without it
        found = Agreement.of(estimate.surface.posed(), observation)
    if found.explained < HALF_EXPLAINED:
        others = f"in front {found.in_front:.0%}, behind {found.behind:.0%}, missing {found.missing:.0%}"
        yield Check(
            "surface",
            f"the estimated surface is where {found.explained:.0%} of the pixels are ({others})",
            "pose, joint states or shape are wrong, or much of the mask is not the object",
            "look at estimate.png, where these pixels are coloured; try a better mask or another viewpoint",
            grave=found.explained < UNEXPLAINED,
        )


def network_doubts(keypoint_std: np.ndarray, category: Category) -> Iterator[Check]:
    """Where the network itself does not trust its keypoints: ``keypoint_std`` (M,) metres."""
    unit, expected = category.metres_per_unit, float(np.exp(np.log(keypoint_std).mean()))
    if not expected < HIGH_KEYPOINT_ERROR * unit:
        yield Check(
            "network",
            f"the network expects its keypoints to be {1000 * expected:.1f} mm off,"
            f" under {1000 * HIGH_KEYPOINT_ERROR * unit:.1f} mm is usual",
            "this view may not show which side is the front, or the object is of another category or badly cut out",
            "try another viewpoint, a better mask, or --gravity where the object stands upright",
        )


def part_doubts(shares: np.ndarray, category: Category) -> Iterator[Check]:
    """Where hardly anything of a moving part is seen: ``shares`` (K,) of the points that are on each part."""
    if not shares.any():
        return
    for joint, part, share in zip(category.joints, category.parts[1:], shares[1:], strict=True):
        if share < HARDLY_SEEN:
            yield Check(
                "part",
                f"hardly anything of {part.name} is seen ({share:.1%} of the object's points)",
                "it is hidden, cut off, on the far side, or left out of the mask",
                f"take the state of {joint.name} for a guess, or look from where {part.name} shows",
            )


def _nothing_else(estimate: Estimate) -> Iterator[Check]:
    """Where an answer is doubtful, and no one thing says why."""
    if estimate.doubtful:
        yield Check(
            "probability",
            f"answers like this one are right {chance(estimate.supposed_probability)} of the time",
            "many numbers that are each still usual together are not: few points, a poor view, a shape unlike others",
            "try another viewpoint or a better mask; where patches of depth are wrong, drop_flying (--drop-flying)",
        )


def hand_doubts(probability: float | None) -> Iterator[Check]:
    """Where the view hardly shows which of two mirror images the object is."""
    if probability is not None and probability < SURE_OF_HAND:
        yield Check(
            "hand",
            f"that it is hinged on this side and not on the other is {probability:.0%} probable",
            "a door that is all but shut, or seen from behind, shows little of its hinges",
            "look again from the front, or once it is open",
        )
