"""What observation and answer alone say against it."""

from collections.abc import Iterator

import numpy as np

from omad.common.errors import InputError
from omad.geometry.camera import times_too_large
from omad.geometry.rigid import box
from omad.model.surfaces.agreement import Agreement
from omad.objects.category import Category
from omad.objects.sizes import is_of_size, usual_size, wrong_scale
from omad.sensing.cutting.not_depth import ENOUGH, Z_BUFFER, NotDepth, may_be_z_buffer, what_else
from omad.sensing.observation import Observation

from ..confidence.signals import cut_off
from ..estimate import Estimate, chance
from ..evidence import explanation
from .check import Check

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
UNEXPLAINED = 0.25
"""Share of the pixels of object and surface where the one is where the other is, 0.7 in a usual view, below which they
are of two things."""
HALF_EXPLAINED = 0.5
"""That of a fitted surface of which nothing is said."""
SURE_OF_HAND = 0.75
"""Of views whose hand is told less surely, one in three is taken for its mirror image; of all others one in fifty."""
SURROUNDED = 0.1
"""Share of the image from which on what is seen beside the object tells of the camera."""
HARDLY_SEEN = 0.02
"""Share of the object's points below which a part hardly shows. In views that hide a quarter or cut it off, one part in
ten does, and its joint state is five to ten times as far off as the others."""
CUT_OFF = 0.1
"""Pixels at one border of the image from which on the object runs out of it, as a share of its width in pixels."""


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
