"""A-NCSH as an estimator: from one view to part poses and joints, as ``omad.Estimator`` gives them."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import compress
from pathlib import Path
from typing import Self

import torch

from omad.common.batches import batched
from omad.common.runtime import Stopwatch, pick_device
from omad.model.checkpoint import load
from omad.model.network_input import first_frame, sample_clouds, to_input_frame
from omad.objects.category import Category
from omad.objects.pose import ObjectPose
from omad.sensing.observation import Observation

from .alignment import AlignmentConfig, Poses, align
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
    def from_folder(cls, folder: Path, device: str = "auto", config: AncshConfig | None = None) -> Self:
        """``folder``: a checkpoint that ``omad train ancsh`` wrote. Raises InputError."""
        return cls(load(AncshNet, folder), config, pick_device(device))

    @property
    def category(self) -> Category:
        return self.net.category

    def __call__(self, observations: Sequence[Observation]) -> list[AncshEstimate]:
        """Estimate observations; each one's answer is the same whatever the others are."""
        return [each for some in batched(observations, self.config.batch) for each in self._estimate(some)]

    @torch.no_grad()
    def _estimate(self, observations: Sequence[Observation]) -> list[AncshEstimate]:
        watch = Stopwatch(self.device)
        config, category = self.config, self.category
        points, samples = self.net.backbone.config.points, sum(config.samples)
        clouds, _ = sample_clouds(observations, points, samples, config.seed, category, self.device)
        frame = first_frame(clouds.flatten(1, 2))
        for seen in clouds.split(config.samples, dim=1):
            # what the network says, in the frame, of all points of the samples (B, samples, n, 3) together
            frames = frame[:, None].expand(-1, seen.shape[1], -1, -1).flatten(0, 1)
            each = self.net(to_input_frame(seen.flatten(0, 1), frames))
            said = AncshPrediction(*(v.unflatten(0, seen.shape[:2]).flatten(1, 2) for v in vars(each).values()))
            watch.lap("network")
            aligned = align(seen.flatten(1, 2), said, category, config.alignment)
            base = aligned.joined.T_camera_part[:, 0].to(frame)
            frame = torch.where(aligned.found[:, :1, None], base, frame)
            watch.lap("refinement")
        separate, joined = (_metric(poses, category) for poses in (aligned.separate, aligned.joined))
        names = [part.name for part in category.parts]
        missing = (tuple(compress(names, lost)) for lost in (~aligned.found).tolist())
        seconds = watch.shares(len(observations))
        return [AncshEstimate(category, *each, dict(seconds)) for each in zip(separate, joined, missing, strict=True)]


def _metric(poses: Poses, category: Category) -> list[ObjectPose]:
    """Each object's poses in metres."""
    unit = category.metres_per_unit
    states, axes, pivots, T = (values.double().cpu().numpy().copy() for values in vars(poses).values())
    T[..., :3, 3] *= unit
    return ObjectPose(states * category.state_units, axes, pivots * unit, T).rows()
