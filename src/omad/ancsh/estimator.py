"""A-NCSH as an estimator: from one view to part poses and joints, as ``omad.Estimator`` gives them."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from ..categories import Category
from ..checkpoint import load_ancsh
from ..metrics import ObjectPose
from ..observation import Observation
from ..omadnet import first_frame, to_input_frame
from ..runtime import pick_device
from ..views import sample_clouds
from .alignment import Alignment, AlignmentConfig, Poses, align
from .net import AncshNet, AncshPrediction


@dataclass(frozen=True)
class AncshConfig:
    """How an observation is looked at; looks and samples are those of ``omad.EstimatorConfig``."""

    samples: tuple[int, ...] = (1, 3)
    """Per look, of how many random choices of the points. After a look, the next one is in the base frame it found."""
    alignment: AlignmentConfig = AlignmentConfig()
    seed: int = 0
    batch: int = 16
    """Observations that go through together."""


@dataclass(frozen=True)
class AncshEstimate:
    """One observed object in metres, radians and the camera frame."""

    category: Category
    separate: ObjectPose
    """Every part aligned by itself; NaN is missing."""
    joined: ObjectPose
    """Parts held together by their joints; NaN is missing."""
    missing_parts: tuple[str, ...]
    seconds: dict[str, float] = field(default_factory=dict)
    """Per observation: ``network``, and ``refinement``, which is the alignment."""

    def initial_pose(self) -> ObjectPose:
        """Before joints count, as the metrics take it."""
        return self.separate

    def pose(self) -> ObjectPose:
        """As the metrics take it."""
        return self.joined


class AncshEstimator:
    """Recovers part poses and joints of one category's objects from single views."""

    def __init__(self, net: AncshNet, config: AncshConfig | None = None, device: str | torch.device = "cpu") -> None:
        self.device = torch.device(device)
        self.net = net.to(self.device).eval()
        self.config = config or AncshConfig()

    @classmethod
    def from_folder(cls, folder: Path, device: str = "auto", config: AncshConfig | None = None) -> AncshEstimator:
        """``folder``: a checkpoint that ``omad train ancsh`` wrote. Raises InputError."""
        return cls(load_ancsh(folder), config, pick_device(device))

    @property
    def category(self) -> Category:
        return self.net.category

    def __call__(self, observations: Sequence[Observation]) -> list[AncshEstimate]:
        """Estimate observations; each one's answer is the same whatever the others are."""
        size = self.config.batch
        return [e for i in range(0, len(observations), size) for e in self._estimate(observations[i : i + size])]

    @torch.no_grad()
    def _estimate(self, observations: Sequence[Observation]) -> list[AncshEstimate]:
        began = time.perf_counter()
        config, category = self.config, self.category
        clouds, _ = sample_clouds(
            observations, self.net.backbone.config.points, sum(config.samples), config.seed, category, self.device
        )
        frame = first_frame(clouds.flatten(1, 2))
        network, aligning = 0.0, 0.0
        for used, samples in enumerate(config.samples):
            seen = clouds[:, sum(config.samples[:used]) :][:, :samples]
            said = self._look(seen, frame)
            network += self._lap(began)
            began = time.perf_counter()
            aligned = align(seen.flatten(1, 2), said, category, config.alignment)
            base = aligned.joined.T_camera_part[:, 0].to(frame)
            frame = torch.where(aligned.found[:, :1, None], base, frame)
            aligning += self._lap(began)
            began = time.perf_counter()
        seconds = {"network": network / len(observations), "refinement": aligning / len(observations)}
        return self._answers(aligned, seconds)

    def _look(self, clouds: Tensor, frame: Tensor) -> AncshPrediction:
        """What the network says in ``frame`` (B, 4, 4) of all points of the samples (B, samples, n, 3) together."""
        batch, samples = clouds.shape[:2]
        frames = frame[:, None].expand(-1, samples, -1, -1).flatten(0, 1)
        said = self.net(to_input_frame(clouds.flatten(0, 1), frames))
        return AncshPrediction(
            **{name: v.unflatten(0, (batch, samples)).flatten(1, 2) for name, v in vars(said).items()}
        )

    def _lap(self, began: float) -> float:
        if self.device.type == "cuda":
            torch.cuda.synchronize(self.device)
        return time.perf_counter() - began

    def _answers(self, aligned: Alignment, seconds: dict[str, float]) -> list[AncshEstimate]:
        names = [part.name for part in self.category.parts]
        separate, joined = (_metric(poses, self.category) for poses in (aligned.separate, aligned.joined))
        return [
            AncshEstimate(
                category=self.category,
                separate=separate[b],
                joined=joined[b],
                missing_parts=tuple(name for name, there in zip(names, found, strict=True) if not there),
                seconds=dict(seconds),
            )
            for b, found in enumerate(aligned.found.tolist())
        ]


def _metric(poses: Poses, category: Category) -> list[ObjectPose]:
    """Each object's poses in metres."""
    unit = category.metres_per_unit
    states, axes, pivots, T = (
        values.double().cpu().numpy().copy() for values in (poses.states, poses.axes, poses.pivots, poses.T_camera_part)
    )
    states *= np.where(category.revolute, 1.0, unit)
    pivots *= unit
    T[..., :3, 3] *= unit
    return [ObjectPose(*values) for values in zip(states, axes, pivots, T, strict=True)]
