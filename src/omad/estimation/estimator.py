"""The estimator: cloud -> network -> refinement -> Estimate.

    1. a first look in camera axes; its keypoints are fitted by least squares
    2. a second look in the base frame so found, where every object stands alike; fitted again

Each look shows the network a few random choices of the points and averages what it says, by confidence.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self, overload

import numpy as np
import torch
from scipy.spatial import KDTree
from torch import Tensor

from omad.common.arrays import as_doubles
from omad.common.runtime import Stopwatch, pick_device
from omad.geometry.transforms import transform_points
from omad.model.checkpoint import find_weights, load
from omad.model.fitting.energy import RefinementConfig
from omad.model.fitting.refinement import Refiner
from omad.model.fitting.state import Refined, State, Targets
from omad.model.network_input import first_frame, sample_clouds, to_input_frame
from omad.model.omadnet import OmadNet, Prediction
from omad.model.posed_object import posed_objects
from omad.objects.category import Category
from omad.sensing.observation import Observation

from .checks import network_doubts, size_doubts
from .estimate import Estimate, PoseEstimate
from .known import Known, Near

NOTHING_KNOWN = Known()

Refine = Callable[[Refiner, Targets, State], Refined]
"""Minimises the energy that a refiner states, from an initial state."""


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

    def __init__(
        self,
        net: OmadNet,
        config: EstimatorConfig | None = None,
        device: str | torch.device = "cpu",
        refine: Refine = Refiner.__call__,
    ) -> None:
        """``refine`` takes the place of least squares, for comparison."""
        self.device = torch.device(device)
        self.net = net.to(self.device).eval()
        self.config = config or EstimatorConfig()
        self.refine = refine
        self._kept: Refiner | None = None

    @classmethod
    def from_pretrained(
        cls,
        weights: str | Path,
        device: str = "auto",
        config: EstimatorConfig | None = None,
        refine: Refine = Refiner.__call__,
    ) -> Self:
        """``weights``: a category with shipped weights, or a checkpoint folder. Raises InputError."""
        return cls(load(OmadNet, find_weights(weights)), config, pick_device(device), refine)

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
        prior, category = self.net.prior, self.category
        [posed] = posed_objects(prior, category, state.start(category, prior.learned_basis))
        moved = PoseEstimate.of(category, posed, _state_std(covariance, category))
        return replace(estimate, **vars(moved), covariance=covariance)

    @torch.no_grad()
    def _estimate(self, observations: Sequence[Observation], known: Known, near: Near | None = None) -> list[Estimate]:
        config, watch = self.config, Stopwatch(self.device)
        looks = config.samples if near is None else (config.near_samples,)
        size = self.net.backbone.config.points
        clouds, chosen = sample_clouds(observations, size, sum(looks), config.seed, self.category, self.device)
        start = None if near is None else near.start(self.category, clouds)
        frame = first_frame(clouds.flatten(1, 2)) if start is None else start.T_camera_base
        seen: list[_Look] = []
        for cloud in clouds.split(looks, dim=1):
            seen.append(self._look(cloud, frame))
            watch.lap("network")
            refined = self._refine(seen[-1], start, known, near)
            start, frame = refined.state, refined.state.T_camera_base
            watch.lap("refinement")
        return self._answers(observations, chosen, seen, refined, watch.shares(len(observations)))

    def _look(self, clouds: Tensor, frame: Tensor) -> _Look:
        """Run the network in ``frame`` (B, 4, 4) on all samples of each cloud and average its answers."""
        samples = clouds.shape[1]
        frames = frame[:, None].expand(-1, samples, -1, -1).flatten(0, 1)
        said: Prediction = self.net(to_input_frame(clouds.flatten(0, 1), frames))
        log_sigma = said.log_sigma
        if not self.config.confidence:
            log_sigma = log_sigma.mean(-1, keepdim=True).expand_as(log_sigma)

        def each(values: Tensor) -> Tensor:
            return values.unflatten(0, (-1, samples))

        precision = each((-2 * log_sigma).exp())
        total = precision.sum(1)
        mean = (precision[..., None] * each(transform_points(frames, said.keypoints))).sum(1) / total[..., None]
        poses = each(frames @ said.T_input_base)[:, 0]
        state = State(each(said.beta).mean(1), each(said.states).mean(1), poses)
        return _Look(Targets(mean, total / samples), state, each(said.part_logits).flatten(1, 2))

    def _refine(self, look: _Look, start: State | None, known: Known, near: Near | None) -> Refined:
        """From ``start``, or where there is none from the network's answer with the base where its keypoints say: they
        have no seam, as its quaternion has one somewhere on the circle around the object."""
        refiner = self._refiner(known)
        start = known.apply_to(start or refiner.with_fitted_pose(look.targets, look.state), self.category)
        if near is not None:
            refiner = refiner.with_shape_prior(torch.as_tensor(near.beta), torch.as_tensor(near.beta_covariance))
        return self.refine(refiner, look.targets, start)

    def _refiner(self, known: Known) -> Refiner:
        """The one for nothing known is kept."""
        config, prior = self.config.refinement, self.net.prior
        if known.is_nothing and self._kept is not None and self._kept.config is config:
            return self._kept
        limits = torch.tensor([j.limits for j in self.category.joints], device=self.device)
        refiner = Refiner(prior, limits, config, known.free(self.category, prior.basis_size))
        if known.is_nothing:
            self._kept = refiner
        return refiner

    def _answers(
        self, observations: Sequence[Observation], chosen: Sequence[np.ndarray], looks: Sequence[_Look],
        refined: Refined, seconds: dict[str, float],
    ) -> list[Estimate]:  # fmt: skip
        """``chosen``: which points of each observation the looks saw, those of the last look last."""
        category, prior, unit = self.category, self.net.prior, self.category.metres_per_unit
        final, initial = (posed_objects(prior, category, state) for state in (refined.state, looks[0].state))
        # from the refinement's unknowns to metres, radians and beta
        scale = np.concatenate([np.ones(3), np.full(3, unit), category.state_units, np.ones(prior.basis_size)])
        covariance = as_doubles(refined.covariance) * scale[:, None] * scale
        keypoint_std = unit / np.sqrt(as_doubles(looks[-1].targets.weights))
        observed = as_doubles(looks[-1].targets.keypoints) * unit
        labels = looks[-1].part_logits.argmax(-1).cpu().numpy()
        unknown = np.full(len(category.joints), np.nan)
        estimates = []
        for b, observation in enumerate(observations):
            labelled = observation.points[chosen[b][-labels.shape[1] :]]
            _, nearest = KDTree(labelled).query(observation.points)
            doubts = [*size_doubts(observation, category), *network_doubts(keypoint_std[b], category)]
            estimates.append(
                Estimate(
                    **vars(PoseEstimate.of(category, final[b], _state_std(covariance[b], category))),
                    category=category,
                    observed_keypoints=observed[b],
                    keypoint_std=keypoint_std[b],
                    covariance=covariance[b],
                    converged=bool(refined.converged[b]),
                    residual=float(refined.residual[b]) * unit,
                    part_labels=labels[b][nearest],
                    initial=PoseEstimate.of(category, initial[b], unknown),
                    seconds=dict(seconds),
                    warnings=(*observation.warnings, *map(str, doubts)),
                )
            )
        return estimates


def _state_std(covariance: np.ndarray, category: Category) -> np.ndarray:
    """(J,) of a covariance (P, P)."""
    return np.sqrt(np.clip(np.diag(covariance), 0, None))[6 : 6 + len(category.joints)]
