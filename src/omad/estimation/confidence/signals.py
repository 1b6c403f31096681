"""What an estimation knows of its own quality: numbers that are at hand when it ends.

Lengths are in category units; spreads and distances are logarithms, as what matters is their ratio to the usual.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Self

import numpy as np
from torch import Tensor

from omad.common.arrays import as_doubles
from omad.model.fitting.posed_object import PosedObject
from omad.model.fitting.state import Refined, Targets
from omad.model.fronts.network import shipped_front_net
from omad.model.fronts.seen import front_of
from omad.model.omadnet import Prediction
from omad.model.prior import OmadPrior
from omad.model.surfaces.agreement import NOWHERE, Agreement
from omad.model.surfaces.surfaces import Surfaces
from omad.objects.category import Category
from omad.sensing.observation import Observation

IMAGE = (
    "expected error", "worst expected error", "misfit", "residual", "shape", "spread", "turned since the look",
    "moved since the look", "turned from the network's own pose", "outside", "points", "cut off", "size",
    "from the side", "from above", "from the front", "distance", "not converged", "front",
    "surface in front", "surface behind", "surface missing",
)  # fmt: skip
"""Of the whole estimate."""
WITHOUT_SURFACE, WITHOUT_FRONT = IMAGE[:-3], IMAGE[:-4]
"""What is asked for where it is not worth its time to hold the surface against what was seen, or to look at the front,
either."""
ACROSS = 64
"""Pixels of the picture in which surfaces are held against what was seen: 160 tell no more, and take longer."""
JOINT = (
    "std", "network's own state", "spread", "beyond its limits", "travel", "expected error", "misfit", "points",
)  # fmt: skip
"""Of each joint, some of them of the part that it moves."""
LEAST = 1e-3
"""Added to what may vanish, before its logarithm is taken."""
SMALLEST_MOVE = 1e-2
"""The same of turns and moves."""
LARGE = 10.0
"""In place of what is not finite."""


@dataclass(frozen=True, eq=False)
class Signals:
    """Of B estimates with J joints; finite."""

    image: np.ndarray
    """(B, len(IMAGE))."""
    joint: np.ndarray
    """(B, J, len(JOINT))."""
    pooled: np.ndarray
    """(B, pooled) what the network's backbone knew of the cloud in the last look, in the mean over its samples."""

    @classmethod
    def none(cls) -> Self:
        """Of no estimation."""
        return cls(np.zeros((0, len(IMAGE))), np.zeros((0, 0, len(JOINT))), np.zeros((0, 0)))

    def known_by(self, image: tuple[str, ...]) -> Self:
        """Without those of ``IMAGE`` that are beyond the first, ``image``."""
        return replace(self, image=self.image[:, : len(image)])

    def rows(self) -> list[Self]:
        """Each estimate's, batches of one, which keep none of the others."""
        return [type(self)(*(each[b : b + 1].copy() for each in vars(self).values())) for b in range(len(self.image))]

    @classmethod
    def joined(cls, several: Sequence[Self]) -> Self:
        """Of all estimates of ``several``."""
        return cls(*(np.concatenate([getattr(one, field.name) for one in several]) for field in fields(cls)))


class Meter:
    """Reads the signals off an estimation, with a category's constants worked out once."""

    def __init__(self, category: Category, prior: OmadPrior) -> None:
        self._category = category
        parts, limits = len(category.parts), category.limits
        self._parts, self._half, self._middle = parts, np.ptp(limits, axis=1) / 2, limits.mean(1)
        part_of = np.array(category.part_of_keypoint)
        moved = np.stack([part_of == part for part in range(1, parts)], 1).astype(float)
        self._mean_of_part = moved / moved.sum(0)
        self._usual = as_doubles(prior.beta_mean)
        self._precision = np.linalg.pinv(as_doubles(prior.beta_covariance), hermitian=True)

    def __call__(
        self, observations: Sequence[Observation], clouds: Tensor, frame: Tensor, said: Prediction, targets: Targets,
        refined: Refined, posed: Sequence[PosedObject], asked: tuple[str, ...], surfaces: Surfaces | None,
    ) -> Signals:  # fmt: skip
        """Of B observations' last look: in ``frame`` (B, 4, 4) the network was shown ``clouds`` (B, samples, n, 3) and
        ``said`` what they are, (B samples); these are the ``targets`` that the objects so ``posed`` were fitted to.
        ``asked``: the first of ``IMAGE``; what takes time and is not among them is zero.
        ``surfaces``: which the objects have."""
        batch, joints = len(observations), len(self._half)

        def each(values: Tensor) -> np.ndarray:
            return as_doubles(values).reshape(batch, -1, *values.shape[1:])

        rows = as_doubles(refined.state.pack())
        T, states, beta = rows[:, :16].reshape(-1, 4, 4), rows[:, 16 : 16 + joints], rows[:, 16 + joints :]
        start, own, samples = as_doubles(frame), each(said.quaternion)[:, 0], clouds.shape[1]
        turned = start[:, :3, :3].transpose(0, 2, 1) @ T[:, :3, :3]
        away = np.sqrt(np.square(T[:, :3, 3]).sum(1))
        view = -(T[:, :3, 3, None] / away[:, None, None] * T[:, :3, :3]).sum(1)

        keypoints = np.stack([one.keypoints for one in posed]) / self._category.metres_per_unit
        weights = as_doubles(targets.weights)
        log_std = -0.5 * np.log(weights)
        off = weights * np.square(keypoints - as_doubles(targets.keypoints)).sum(-1)
        spread = _variance(each(said.keypoints)).sum(-1).mean(-1) if samples > 1 else np.exp(2 * log_std).mean(1)
        own_states = each(said.states)
        labels = said.part_logits.argmax(-1).numpy(force=True).reshape(batch, -1)
        share = (labels[:, None] == np.arange(1, self._parts + 1)[:, None]).sum(2) / max(labels.shape[1], 1)
        cloud = clouds.numpy(force=True).reshape(batch, -1, 3)
        unusual = beta - self._usual
        image = {
            "expected error": log_std.mean(1),
            "worst expected error": log_std.max(1),
            "misfit": np.log(off.mean(1) + LEAST),
            "residual": np.log(as_doubles(refined.residual) + LEAST),
            "shape": np.log1p((unusual @ self._precision * unusual).mean(1)),
            "spread": np.log(np.sqrt(spread) + LEAST),
            "turned since the look": np.log(_angle(turned.trace(axis1=1, axis2=2)) + SMALLEST_MOVE),
            "moved since the look": np.log(np.sqrt(np.square(T[:, :3, 3] - start[:, :3, 3]).sum(1)) + SMALLEST_MOVE),
            "turned from the network's own pose": np.log(_angle(_trace_between(own, turned)) + SMALLEST_MOVE),
            "outside": np.sqrt(share[:, -1]),
            "points": np.log([len(one.points) for one in observations]),
            "cut off": [min(max(cut_off(one).values(), default=0.0), 1.0) for one in observations],
            "size": np.log(np.sqrt(np.square(cloud.max(1) - cloud.min(1)).sum(1)) + LEAST),
            "from the side": np.abs(view[:, 0]),
            "from above": view[:, 1],
            "from the front": view[:, 2],
            "distance": np.log(away + LEAST),
            "not converged": 1.0 - as_doubles(refined.converged),
            "front": self._front(observations, posed) if "front" in asked else np.zeros(batch),
        }
        unexplained = (
            _unexplained(observations, posed, surfaces) if asked == IMAGE and surfaces else np.zeros((3, batch))
        )
        image |= zip(IMAGE[-3:], unexplained, strict=True)
        travel = (states - self._middle) / self._half
        variance = as_doubles(refined.covariance).diagonal(axis1=1, axis2=2)[:, 6 : 6 + joints]
        joint = {
            "std": np.log(np.sqrt(variance.clip(0)) + LEAST),
            "network's own state": np.log(np.abs(own_states.mean(1) - states) + LEAST),
            "spread": np.log(np.sqrt(_variance(own_states)) + LEAST),
            "beyond its limits": np.log((np.abs(travel) - 1).clip(0) + SMALLEST_MOVE),
            "travel": travel,
            "expected error": log_std @ self._mean_of_part,
            "misfit": np.log(off @ self._mean_of_part + LEAST),
            "points": np.sqrt(share[:, :-1]),
        }
        of_image, of_joints = np.stack([image[name] for name in IMAGE], 1), np.stack([joint[name] for name in JOINT], 2)
        return Signals(*map(_finite, (of_image, of_joints, each(said.pooled).mean(1))))

    def _front(self, observations: Sequence[Observation], posed: Sequence[PosedObject]) -> np.ndarray:
        """(B,) log-odds that the objects are of the category."""
        images = [front_of(one, self._category, seen.points) for one, seen in zip(posed, observations, strict=True)]
        return shipped_front_net().odds(np.stack(images), self._category.name)


def _unexplained(observations: Sequence[Observation], posed: Sequence[PosedObject], surfaces: Surfaces) -> np.ndarray:
    """(3, B) shares of the pixels where the objects' surfaces are in front of what was seen, behind it, and missing."""
    found = [_agreement(*each, surfaces) for each in zip(observations, posed, strict=True)]
    return np.array([[one.in_front, one.behind, one.missing] for one in found]).T


def _agreement(observation: Observation, posed: PosedObject, surfaces: Surfaces) -> Agreement:
    if not np.isfinite(posed.keypoints).all():
        return NOWHERE
    placed = zip(surfaces.of_keypoints(posed.canonical_keypoints), posed.placed.T_camera_part, strict=True)
    return Agreement.of([part.carried(T) for part, T in placed], observation, ACROSS)


def _finite(values: np.ndarray) -> np.ndarray:
    if np.isfinite(values).all():
        return values
    return np.nan_to_num(values, nan=LARGE, posinf=LARGE, neginf=-LARGE)


def _variance(values: np.ndarray) -> np.ndarray:
    """Over samples (B, samples, ...) -> (B, ...); NumPy's own takes its time for checks."""
    off = values - values.sum(1, keepdims=True) / values.shape[1]
    return np.square(off).sum(1) / values.shape[1]


def _angle(traces: np.ndarray) -> np.ndarray:
    """(B,) radians of rotations with such traces."""
    return np.arccos(np.clip((traces - 1) / 2, -1, 1))


def _trace_between(quaternions: np.ndarray, rotations: np.ndarray) -> np.ndarray:
    """(B,) trace of the rotation that takes one (B, 4) to the other (B, 3, 3): a quadratic form in the quaternion
    (Horn, "Closed-form solution of absolute orientation using unit quaternions", 1987)."""
    w, v, R = quaternions[:, 0], quaternions[:, 1:], rotations
    across = w * (v * (R[:, [2, 0, 1], [1, 2, 0]] - R[:, [1, 2, 0], [2, 0, 1]])).sum(1)
    along = (v * (R @ v[..., None])[..., 0]).sum(1)
    return (w * w - (v * v).sum(1)) * R.trace(axis1=1, axis2=2) + 2 * (along + across)


def cut_off(observation: Observation) -> dict[str, float]:
    """Length of the object's pixels along each border of the image, as a share of its width in pixels; none of a bare
    cloud."""
    mask, width = observation.mask, observation.every * len(observation.points) ** 0.5
    if mask is None:
        return {}
    borders = {"left": mask[:, 0], "right": mask[:, -1], "top": mask[0], "bottom": mask[-1]}
    return {name: np.count_nonzero(border) / width for name, border in borders.items()}
