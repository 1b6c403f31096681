"""The estimator: cloud -> network -> refinement -> Estimate.

    1. a first look in camera axes; its keypoints are fitted by least squares
    2. a second look in the base frame so found, where every object stands alike; fitted again

Each look shows the network a few random choices of the points and averages what it says, by confidence.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, overload

import numpy as np
import torch
from scipy.spatial import KDTree
from torch import Tensor

from .adam_recipe import AdamResult, refine_with_adam
from .categories import Category
from .checkpoint import find_weights, load_net
from .estimate import Estimate, InitialEstimate, JointEstimate
from .geometry import transform_points
from .kinematics import joint_lines, part_transforms
from .known import Known, Near
from .observation import Observation
from .omadnet import OmadNet, Prediction, first_frame, to_input_frame
from .prior import OmadPrior
from .refinement import Refined, RefinementConfig, Refiner, State, Targets
from .runtime import pick_device
from .views import sample_clouds

NOTHING_KNOWN = Known()
USUAL_SIZE = 2.5
"""Diagonal of an object's cloud in category units; 1.5 to 4 in standard views."""
DOUBTFUL = 0.07
"""Expected keypoint error (geometric mean, category units; 0.03 is usual) above which an estimate carries a warning."""


@dataclass(frozen=True)
class EstimatorConfig:
    """How an observation is looked at."""

    samples: tuple[int, ...] = (1, 3)
    """Per look, how many random choices of the points it averages. The first look only has to find the frame."""
    near_samples: int = 2
    """The same of the only look at an object that is known to be near a place."""
    refinement: RefinementConfig = RefinementConfig(step_tolerance=1e-4, cost_tolerance=1e-5)
    """Tolerances a hundred times below the network's own error: half the iterations of the defaults."""
    confidence: bool = True
    """False: all keypoints of an object count alike, as in the paper; for comparison."""
    method: Literal["least_squares", "adam"] = "least_squares"
    """'adam' is the paper's own recipe, for comparison: slow, and it gives no covariance."""
    seed: int = 0
    """Which points are chosen; the same observation and seed give the same estimate."""
    batch: int = 128
    """Observations that go through the network together."""


@dataclass(frozen=True)
class _Look:
    """One look at B clouds, in the camera frame and category units."""

    targets: Targets
    state: State
    part_logits: Tensor
    """(B, n, K)."""


class Estimator:
    """Recovers shape, pose and joints of one category's objects from single views."""

    def __init__(self, net: OmadNet, config: EstimatorConfig | None = None, device: str | torch.device = "cpu") -> None:
        self.device = torch.device(device)
        self.net = net.to(self.device).eval()
        self.config = config or EstimatorConfig()
        self._kept: Refiner | None = None

    @classmethod
    def from_pretrained(
        cls, weights: str | Path, device: str = "auto", config: EstimatorConfig | None = None
    ) -> Estimator:
        """``weights``: a category with shipped weights, or a checkpoint folder. Raises InputError."""
        return cls(load_net(find_weights(weights)), config, pick_device(device))

    @property
    def category(self) -> Category:
        return self.net.category

    @overload
    def __call__(self, observation: Observation, known: Known = NOTHING_KNOWN) -> Estimate: ...
    @overload
    def __call__(self, observation: Sequence[Observation], known: Known = NOTHING_KNOWN) -> list[Estimate]: ...
    def __call__(
        self, observation: Observation | Sequence[Observation], known: Known = NOTHING_KNOWN
    ) -> Estimate | list[Estimate]:
        """Estimate one observation, or several as a batch. What is ``known`` holds for all of them, and is kept."""
        known.check(self.category, self.net.prior.basis_size)
        if isinstance(observation, Observation):
            return self._estimate([observation], known)[0]
        size = self.config.batch
        return [e for i in range(0, len(observation), size) for e in self._estimate(observation[i : i + size], known)]

    def near(self, observation: Observation, near: Near) -> Estimate:
        """Estimate an object that was seen before, a moment ago say: one look is enough, which takes half the time."""
        return self._estimate([observation], NOTHING_KNOWN, near)[0]

    def moved(self, estimate: Estimate, state: Near, covariance: np.ndarray) -> Estimate:
        """The answer with another shape, pose and joint states, those of a filter say; ``covariance`` (P, P) theirs."""
        like = self.net.prior.learned_basis
        placed = _Placed.of(self.net.prior, state.start(self.category, like), self.category.metres_per_unit)
        std = np.sqrt(np.clip(np.diag(covariance), 0, None))
        return replace(
            estimate,
            beta=placed.beta[0],
            T_camera_base=placed.T_camera_part[0, 0],
            T_camera_part=placed.T_camera_part[0],
            joints=placed.joints(self.category, 0, std[6:]),
            keypoints=placed.keypoints[0],
            canonical_keypoints=placed.canonical[0],
            canonical_axes=placed.canonical_axes[0],
            canonical_pivots=placed.canonical_pivots[0],
            covariance=covariance,
        )

    @torch.no_grad()
    def _estimate(self, observations: Sequence[Observation], known: Known, near: Near | None = None) -> list[Estimate]:
        began = time.perf_counter()
        looks = self.config.samples if near is None else (self.config.near_samples,)
        clouds, chosen = self._sample(observations, sum(looks))
        frame = first_frame(clouds.flatten(1, 2))
        network, refinement = 0.0, 0.0
        first: _Look | None = None
        start: State | None = None
        if near is not None:
            start = near.start(self.category, frame)
            frame = start.T_camera_base
        for used, samples in enumerate(looks):
            look = self._look(clouds[:, sum(looks[:used]) :][:, :samples], frame)
            network += self._lap(began)
            began = time.perf_counter()
            first = first or look
            refined = self._refine(look, start, known, near)
            start, frame = refined.state, refined.state.T_camera_base
            refinement += self._lap(began)
            began = time.perf_counter()
        assert first is not None
        seconds = {"network": network / len(observations), "refinement": refinement / len(observations)}
        return self._answers(observations, chosen, first, look, refined, seconds)

    def _lap(self, began: float) -> float:
        if self.device.type == "cuda":
            torch.cuda.synchronize(self.device)
        return time.perf_counter() - began

    def _sample(self, observations: Sequence[Observation], samples: int) -> tuple[Tensor, list[np.ndarray]]:
        """Random points of each cloud, in category units: (B, samples, n, 3), and which they are."""
        size = self.net.backbone.config.points
        return sample_clouds(observations, size, samples, self.config.seed, self.category, self.device)

    def _look(self, clouds: Tensor, frame: Tensor) -> _Look:
        """Run the network in ``frame`` (B, 4, 4) on all samples of each cloud and average its answers."""
        batch, samples = clouds.shape[:2]
        frames = frame[:, None].expand(-1, samples, -1, -1).flatten(0, 1)
        said: Prediction = self.net(to_input_frame(clouds.flatten(0, 1), frames))
        log_sigma = said.log_sigma
        if not self.config.confidence:
            log_sigma = log_sigma.mean(-1, keepdim=True).expand_as(log_sigma)
        precision = (-2 * log_sigma).exp().unflatten(0, (batch, samples))
        keypoints = transform_points(frames, said.keypoints).unflatten(0, (batch, samples))
        total = precision.sum(1)
        mean = (precision[..., None] * keypoints).sum(1) / total[..., None]
        poses = (frames @ said.T_input_base).unflatten(0, (batch, samples))
        return _Look(
            targets=Targets(keypoints=mean, weights=total / samples),
            state=State(
                beta=said.beta.unflatten(0, (batch, samples)).mean(1),
                joint_states=said.states.unflatten(0, (batch, samples)).mean(1),
                T_camera_base=poses[:, 0],
            ),
            part_logits=said.part_logits.unflatten(0, (batch, samples)).flatten(1, 2),
        )

    def _refine(self, look: _Look, start: State | None, known: Known, near: Near | None) -> Refined:
        """From ``start``, or where there is none from the network's answer with the base where its keypoints say: they
        have no seam, as its quaternion has one somewhere on the circle around the object."""
        prior, targets, refiner = self.net.prior, look.targets, self._refiner(known)
        start = known.impose(start or refiner.placed(targets, look.state), self.category)
        if self.config.method == "adam":
            with torch.enable_grad():
                found = refine_with_adam(prior, targets, start)
            return _as_refined(prior, targets, found)
        if near is not None:
            refiner = refiner.believing(torch.as_tensor(near.beta), torch.as_tensor(near.beta_covariance))
        return refiner(targets, start)

    def _refiner(self, known: Known) -> Refiner:
        """The one for nothing known is kept."""
        config = self.config.refinement
        if known is NOTHING_KNOWN and self._kept is not None and self._kept.config is config:
            return self._kept
        limits = torch.tensor([j.limits for j in self.category.joints], device=self.device)
        refiner = Refiner(self.net.prior, limits, config, known.free(self.category, self.net.prior.basis_size))
        if known is NOTHING_KNOWN:
            self._kept = refiner
        return refiner

    def _answers(self, observations, chosen, first: _Look, last: _Look, refined: Refined, seconds) -> list[Estimate]:
        category, prior, unit = self.category, self.net.prior, self.category.metres_per_unit
        scale = self._metric_scale()
        final, initial = _Placed.of(prior, refined.state, unit), _Placed.of(prior, first.state, unit)
        covariance = _numpy(refined.covariance) * scale[:, None] * scale
        std = np.sqrt(np.clip(np.diagonal(covariance, axis1=1, axis2=2), 0, None))
        keypoint_std = unit / np.sqrt(_numpy(last.targets.weights))
        observed = _numpy(last.targets.keypoints) * unit
        labels = last.part_logits.argmax(-1).cpu().numpy()
        labelled = slice(-labels.shape[1], None)  # the points of the last look
        estimates = []
        for b, observation in enumerate(observations):
            _, nearest = KDTree(observation.points[chosen[b][labelled]]).query(observation.points)
            joints = final.joints(category, b, std[b, 6 : 6 + len(category.joints)])
            unknown = np.full(len(category.joints), np.nan)
            estimates.append(
                Estimate(
                    category=category,
                    beta=final.beta[b],
                    T_camera_base=final.T_camera_part[b, 0],
                    T_camera_part=final.T_camera_part[b],
                    joints=joints,
                    keypoints=final.keypoints[b],
                    canonical_keypoints=final.canonical[b],
                    canonical_axes=final.canonical_axes[b],
                    canonical_pivots=final.canonical_pivots[b],
                    observed_keypoints=observed[b],
                    keypoint_std=keypoint_std[b],
                    covariance=covariance[b],
                    converged=bool(refined.converged[b]),
                    residual=float(refined.residual[b]) * unit,
                    part_labels=labels[b][nearest],
                    initial=InitialEstimate(
                        joints=initial.joints(category, b, unknown),
                        T_camera_base=initial.T_camera_part[b, 0],
                        beta=initial.beta[b],
                        T_camera_part=initial.T_camera_part[b],
                        keypoints=initial.keypoints[b],
                    ),
                    seconds=dict(seconds),
                    warnings=observation.warnings
                    + _size_doubts(observation.points, category)
                    + _doubts(keypoint_std[b] / unit),
                )
            )
        return estimates

    def _metric_scale(self) -> np.ndarray:
        """(P,) factors from the refinement's unknowns to metres, radians and beta."""
        unit = self.category.metres_per_unit
        states = [1.0 if joint.type == "revolute" else unit for joint in self.category.joints]
        return np.array([1.0] * 3 + [unit] * 3 + states + [1.0] * self.net.prior.basis_size)


@dataclass(frozen=True)
class _Placed:
    """States of B objects written out in metres and the camera frame."""

    beta: np.ndarray
    states: np.ndarray
    axes: np.ndarray
    pivots: np.ndarray
    T_camera_part: np.ndarray
    keypoints: np.ndarray
    canonical: np.ndarray
    canonical_axes: np.ndarray
    canonical_pivots: np.ndarray

    @classmethod
    def of(cls, prior, state: State, unit: float) -> _Placed:
        joints = prior.joints(state.beta)
        G = part_transforms(prior.tree, joints.axes, joints.pivots, state.joint_states, state.T_camera_base)
        lines = joint_lines(prior.tree, joints.axes, joints.pivots, G)
        metric = _numpy(G).copy()
        metric[..., :3, 3] *= unit
        return cls(
            beta=_numpy(state.beta),
            states=_numpy(torch.where(prior.revolute, state.joint_states, state.joint_states * unit)),
            axes=_numpy(lines.axes),
            pivots=_numpy(lines.pivots) * unit,
            T_camera_part=metric,
            keypoints=_numpy(prior.deform(state.beta, state.joint_states, state.T_camera_base)) * unit,
            canonical=_numpy(prior.keypoints(state.beta)) * unit,
            canonical_axes=_numpy(joints.axes),
            canonical_pivots=_numpy(joints.pivots) * unit,
        )

    def joints(self, category: Category, b: int, std: np.ndarray) -> tuple[JointEstimate, ...]:
        answers = []
        for j, spec in enumerate(category.joints):
            revolute = spec.type == "revolute"
            low, high = (limit if revolute else limit * category.metres_per_unit for limit in spec.limits)
            answers.append(
                JointEstimate(
                    name=spec.name,
                    type=spec.type,
                    state=float(self.states[b, j]),
                    state_std=float(std[j]),
                    limits=(low, high),
                    axis=self.axes[b, j],
                    pivot=self.pivots[b, j] if revolute else None,
                )
            )
        return tuple(answers)


def _size_doubts(points: np.ndarray, category: Category) -> tuple[str, ...]:
    """A warning where the cloud cannot be an object of the category at its size: a wrong depth scale, mostly."""
    size, usual = float(np.linalg.norm(np.ptp(points, axis=0))), USUAL_SIZE * category.metres_per_unit
    if usual / 4 < size < 4 * usual:
        return ()
    return (
        f"the cloud is {size:.3g} m across, a {category.name} about {usual:.2g} m: is the depth scale right,"
        " and is the object cut out?",
    )


def _doubts(keypoint_std: np.ndarray) -> tuple[str, ...]:
    """A warning where the network itself does not trust its keypoints (M,), in category units."""
    expected = float(np.exp(np.log(keypoint_std).mean()))
    if expected < DOUBTFUL:
        return ()
    return (
        f"doubtful: keypoints are expected to be {expected:.2f} category units off; this view may not show which side"
        " is the front, or the object may be of another category or badly cut out; try another viewpoint",
    )


def _as_refined(prior: OmadPrior, targets: Targets, adam: AdamResult) -> Refined:
    """Adam's result in the form of the least-squares one; it knows nothing of covariance."""
    size = 6 + adam.state.joint_states.shape[1] + adam.state.beta.shape[1]
    unknown = torch.full((len(adam.energy), size, size), torch.nan, dtype=torch.float64)
    every = torch.eye(size, dtype=torch.float64)
    keypoints = prior.deform(adam.state.beta, adam.state.joint_states, adam.state.T_camera_base)
    squared = (keypoints - targets.keypoints).square().sum(-1)
    return Refined(adam.state, unknown, every, adam.converged, adam.steps, targets.weights, squared)


def _numpy(tensor: Tensor) -> np.ndarray:
    return tensor.detach().cpu().double().numpy()
