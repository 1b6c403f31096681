"""From an observation to its Siamese embedding."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch

from ..checkpoint import load_siamese
from ..observation import Observation
from ..omadnet import first_frame, to_input_frame
from ..runtime import pick_device
from ..views import sample_clouds
from .siamese import SiameseNet


class SiameseEncoder:
    """Embeds observations: the mean over a few random choices of their points, as many as OMAD's estimator looks at."""

    def __init__(
        self, net: SiameseNet, device: torch.device | str = "cpu", samples: int = 4, seed: int = 0, batch: int = 128
    ) -> None:
        self.device = torch.device(device)
        self.net = net.to(self.device).eval()
        self.samples, self.seed, self.batch = samples, seed, batch

    @classmethod
    def from_folder(cls, folder: Path, device: str = "auto") -> SiameseEncoder:
        """From a checkpoint folder. Raises InputError."""
        return cls(load_siamese(folder), pick_device(device))

    @torch.no_grad()
    def __call__(self, observations: Sequence[Observation]) -> np.ndarray:
        """(B, E) float64."""
        embedded = []
        for start in range(0, len(observations), self.batch):
            some, size = observations[start : start + self.batch], self.net.backbone.config.points
            clouds, _ = sample_clouds(some, size, self.samples, self.seed, self.net.category, self.device)
            points = clouds.flatten(0, 1)
            said = self.net(to_input_frame(points, first_frame(points)))
            embedded.append(said.unflatten(0, (len(some), -1)).mean(1).cpu().double().numpy())
        return np.concatenate(embedded)
