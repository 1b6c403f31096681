"""Several views of one object at one moment, fitted together: the least squares have the keypoints of all views.

    1. each view is fitted alone; the answer that explains all views best is where the fit of all starts
    2. views that contradict it, seen the wrong way round or after a joint has moved, say, are left out; the others'
       keypoints are targets together

The estimator does so after each look, so that the second look at every view is in the frame that most agree on.

Views of one object err alike, for it is the same object: from five degrees further a network takes a thin screen for a
thick one again. A view counts as 1 / (sum of its errors' correlations with those of all views, itself included): views
from one place count as one, and the covariance shrinks by no more than further views tell.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from omad.common.arrays import as_doubles, numbers
from omad.common.errors import InputError
from omad.common.runtime import undisturbed
from omad.geometry.rigid import is_rigid
from omad.geometry.transforms import MIRROR_X, invert_transform, transform_points, vector_angle
from omad.model.fitting.state import Refined, State, Targets
from omad.model.prior import OmadPrior
from omad.objects.category import Category

from .checks import Check
from .estimate import Estimate
from .joint_estimate import JointEstimate

APART = np.radians(35.0)
"""Angle between two views at which what they have in common beside the object has fallen to 1 / e. For noisy views of
unseen procedural objects (``benchmarks/accuracy/bench_several_views.py``): over five categories, errors of views less
than 20 degrees apart correlate by 0.79, of those 20 to 40, 40 to 60, and 60 to 90 degrees apart by 0.75, 0.66, 0.63."""
CONTRADICTS = 0.2
"""Median distance of a view's keypoints from where an answer has them, category units, from which on both cannot be
right; 0.02 to 0.06 is usual."""
SURE = 3.5
"""Joint states that two views tell alone are of two moments where they are apart by more than so many times the larger
standard deviation. Of 360 pairs and triples of noisy views of twelve categories none are said to be, of 262 where a
joint moved all but 6."""
COARSEST = 1e-3
"""Metres that positions of cameras may be rounded to."""
SAME_TURN, SAME_SLIDE = np.radians(10), 0.2
"""Radians and category units up to which two joint states are one: an answer is right of both."""


@dataclass(frozen=True)
class Rig:
    """Where the cameras of V views are."""

    T_first_camera: Tensor
    """(V, 4, 4) category units."""
    alike: Tensor
    """(V, V) bool: which views tell the same joint states."""
    shared: float
    """Correlation of the errors of views from quite different sides: what comes from the object."""

    @classmethod
    @undisturbed()
    def of(cls, T_first_camera: np.ndarray, alone: Sequence[Estimate], shared: float, like: Tensor) -> Rig:
        """Of cameras at ``T_first_camera`` (V, 4, 4), in metres, and what each view tells ``alone``; dtype and device
        are those of ``like``."""
        placed = T_first_camera.copy()
        placed[:, :3, 3] /= alone[0].category.metres_per_unit
        alike = [[_alike(one, other) for other in alone] for one in alone]
        return cls(torch.as_tensor(placed).to(like), torch.tensor(alike, device=like.device), shared)

    def mirrored(self) -> Rig:
        """Of what all of them see in mirrors in their planes x = 0."""
        sign = self.T_first_camera.new_tensor([*MIRROR_X, 1.0])
        return replace(self, T_first_camera=sign[:, None] * self.T_first_camera * sign)

    def in_first(self, state: State) -> State:
        """States of V camera frames in the first camera's."""
        return replace(state, T_camera_base=self.T_first_camera @ state.T_camera_base)

    def carried(self, targets: Targets) -> Targets:
        """Targets (V, M) of V camera frames in the first camera's."""
        return replace(targets, keypoints=transform_points(self.T_first_camera, targets.keypoints))

    def together(self, seen: Targets, keypoints: Tensor) -> tuple[Tensor, Targets]:
        """Of answers to each view alone, their ``keypoints`` (V, M, 3), the index (1,) of the one that explains all
        views best; and what is ``seen`` (V, M), all in the first camera's frame, as targets (1, M V) of one fit: every
        keypoint V times in turn, without the views that contradict this answer."""
        apart = (keypoints[:, None] - seen.keypoints).norm(dim=-1)
        cost = (seen.weights.sqrt() * apart).sum(2)
        lost = cost.diagonal().isnan()  # views without numbers; all others are compared by what they say
        cost = cost.masked_fill(lost, 0.0).sum(1).masked_fill(lost, torch.inf)
        best = cost.nan_to_num(torch.inf).argmin(keepdim=True)
        agree = ((apart[best[0]].median(-1).values < CONTRADICTS) & self.alike[best[0]]).to(cost)
        agree[best] = 1.0
        lines = keypoints[best].mean(1) - self.T_first_camera[:, :3, 3]
        counts = (correlation(lines, self.shared) * agree).sum(1, keepdim=True)
        weights = torch.where(agree[:, None] > 0, seen.weights / counts, 0.0)
        return best, Targets(seen.keypoints.transpose(0, 1).reshape(1, -1, 3), weights.mT.reshape(1, -1))

    def each(self, found: Refined, prior: OmadPrior, targets: Targets) -> Refined:
        """An answer (a batch of one) in the first camera's frame in those of all cameras, with its distances from each
        view's own targets (V, M)."""
        one, views, T = found.state, len(self.T_first_camera), invert_transform(self.T_first_camera)
        turn = torch.eye(found.covariance.shape[-1]).to(found.covariance).repeat(views, 1, 1)
        turn[:, :3, :3] = turn[:, 3:6, 3:6] = T[:, :3, :3].to(turn)
        state = State(one.beta.expand(views, -1), one.joint_states.expand(views, -1), T @ one.T_camera_base)
        points = prior.deform(state.beta, state.joint_states, state.T_camera_base)
        ends = found.converged.expand(views), found.iterations.expand(views)
        return Refined.of(state, points, targets, turn @ found.covariance @ turn.mT, *ends)


def relative_poses(T_world_camera: Any, views: int) -> np.ndarray:
    """T_first_camera (V, 4, 4) of so many cameras at poses (V, 4, 4) in any one frame, in metres. Raises InputError for
    another shape, for what is no rigid transform, and for single precision where it rounds too much."""
    poses = numbers(T_world_camera, views, 4, 4, what="T_world_camera", unknown=True)
    for number, T in enumerate(poses, 1):
        if not is_rigid(T):
            raise InputError(f"T_world_camera: that of view {number} is no rotation and translation; correct it")
    single = poses.astype(np.float32)
    step = float(np.spacing(np.abs(single[:, :3, 3]).max()))
    if step > COARSEST and (single == poses).all():
        told = f"single precision knows positions so far from the origin to {step:.2g} m only"
        raise InputError(f"T_world_camera: {told}; give doubles, or poses in a frame that is near")
    return np.linalg.inv(poses[0]) @ poses


def alike_by_angle(angle: np.ndarray) -> np.ndarray:
    """What of the errors of two views from directions ``angle`` (radians) apart is alike beside what is of the object,
    from 1 at none."""
    return np.exp(-angle / APART)


def correlation(lines: Tensor, shared: float) -> Tensor:
    """(V, V) of the errors of views along ``lines`` (V, 3), of which ``shared`` is of the object."""
    angle = as_doubles(vector_angle(lines[:, None], lines[None]))
    return torch.as_tensor(shared + (1 - shared) * alike_by_angle(angle)).to(lines)


@undisturbed()
def one_answer(estimates: Sequence[Estimate], alone: Sequence[Estimate], shared: float) -> list[Estimate]:
    """The estimates of all views, each with the warnings of all, and a further one where a view contradicts them, by
    where it sees the object or by the joint states that it tells ``alone``. How sure the answer is, the views that
    agree say together: it is a little surer than the median of them, as the mean of values is whose errors have so much
    in common, ``shared`` from quite different sides. Where they are not most of the views it may as well be wrong, and
    so it may be in the frame of a view that contradicts it."""
    estimates = [replace(one, joints_alone=own.joints) for one, own in zip(estimates, alone, strict=True)]
    against = [bool([*contradictions(estimate)]) for estimate in estimates]
    agree = [estimate for estimate, other in zip(estimates, against, strict=True) if not other] or list(estimates)
    spreads = [[(joint.state_std, joint.tail) for joint in estimate.joints] for estimate in agree]
    std, tail = np.median(spreads, axis=0).T
    std *= _shrinkage(agree, shared)
    size = np.median([_base_size(estimate) for estimate in agree], axis=0)
    told = [estimate.probability for estimate in agree if estimate.probability is not None]
    share = len(agree) / len(estimates) if any(against) else 1.0
    made = []
    for estimate, other in zip(estimates, against, strict=True):
        believed = min(share, 1 - share) if other else share if share <= 0.5 else 1.0
        probability = believed * float(np.quantile(told, 2 / 3)) if told else None
        sure = zip(estimate.joints, std.tolist(), tail.tolist(), strict=True)
        joints = tuple(replace(joint, state_std=own, tail=power) for joint, own, power in sure)
        base_std = estimate.base_std * np.repeat(size / _base_size(estimate), 3)
        made.append(replace(estimate, joints=joints, base_std=base_std, probability=probability))
    # a view that contradicts the answer was last looked at where that has the object: of it counts what it says alone
    rows = zip(made, alone, against, strict=True)
    found = [(*map(str, contradictions(one)), *own.warnings) if other else one.warnings for one, own, other in rows]
    warnings = tuple(f"view {number}: {warning}" for number, own in enumerate(found, 1) for warning in own)
    return [replace(estimate, warnings=warnings) for estimate in made]


def _base_size(estimate: Estimate) -> np.ndarray:
    """(2,) how large its base's deviations of rotation and translation are, whatever the camera's axes."""
    return np.linalg.norm(estimate.base_std.reshape(2, 3), axis=1)


def _shrinkage(estimates: Sequence[Estimate], shared: float) -> float:
    """Standard deviation of the mean of what the views say, as a share of one view's."""
    lines = torch.as_tensor(np.stack([np.linalg.inv(estimate.T_camera_base)[:3, 3] for estimate in estimates]))
    return float(correlation(lines, shared).mean().sqrt())


def contradictions(estimate: Estimate) -> Iterator[Check]:
    """Where one of several views, whose ``estimate`` this is, says something else than the answer to all of them."""
    category = estimate.category
    apart = float(np.median(np.linalg.norm(estimate.keypoints - estimate.observed_keypoints, axis=1)))
    if apart >= CONTRADICTS * category.metres_per_unit:
        yield Check(
            "views",
            f"half of its keypoints are {1000 * apart:.0f} mm or more from where the answer to all views has them",
            "its T_world_camera may be wrong, the object may have moved, or the network sees another side of it",
            "see that T_world_camera takes camera to world coordinates, in metres; leave the view out, or add others",
        )
    own = estimate.joints_alone or estimate.joints
    spread = [joint.state_std for joint in own]
    moved = np.flatnonzero(_apart(own, estimate.joints, spread, category))
    if len(moved):
        said, answer = (", ".join(str(joints[i]) for i in moved) for joints in (own, estimate.joints))
        yield Check(
            "joints",
            f"alone it says {said}, the answer to all views is {answer}",
            "a joint may have moved between the views, or one of them may be seen wrongly",
            "give views of one moment, or leave the view out",
        )


def _alike(one: Estimate, other: Estimate) -> bool:
    """Whether two views tell the same joint states."""
    spread = np.max([[joint.state_std for joint in each.joints] for each in (one, other)], axis=0)
    return not _apart(one.joints, other.joints, spread, one.category).any()


def _apart(
    joints: Sequence[JointEstimate], others: Sequence[JointEstimate], spread: ArrayLike, category: Category
) -> np.ndarray:
    """(J,) bool: which joints are not where the others are; ``spread`` (J,) is the standard deviation of telling it."""
    by = np.array([joint.state - other.state for joint, other in zip(joints, others, strict=True)])
    same = np.where(category.turning, SAME_TURN, SAME_SLIDE * category.metres_per_unit)
    return np.abs(by) > np.maximum(SURE * np.asarray(spread), same)
