"""Answers that begin in turned frames, to clouds that the network is unsure of: which of them count."""

import torch
from torch import Tensor

from omad.geometry.transforms import quarter_turns

UNSURE = 0.08
"""Expected keypoint error (geometric mean, category units; 0.03 is usual) above which an object is looked at in turned
frames, too."""
SURER = 0.5
"""The error that another answer expects must be so many times smaller to take its place ..."""
SURER_INVERTED = 0.33
"""... and so many times, where it stands on its head in the image and the other does not. Much that stands looks alike
on its head."""
HALF_TURNS = quarter_turns()[3:6]
"""(3, 4, 4)."""


def surer(expected: Tensor, found: Tensor, expected_turned: Tensor, turned: Tensor) -> tuple[Tensor, Tensor]:
    """Which of B answers give way (n,), and each to which of its three others (n,): to the surest, if it is so much
    surer. What errors they expect, (B,) and (3 B,), and their ``T_camera_base`` (B, 4, 4) and (3 B, 4, 4)."""
    inverted = (found[:, None, 1, 1] < 0) & (turned[:, 1, 1].view(len(found), -1) >= 0)
    ahead = torch.where(inverted, SURER_INVERTED, SURER)
    missed, best = (expected_turned.view_as(ahead) / ahead).min(1)
    better = torch.nonzero(missed < expected)[:, 0]
    return better, best[better]
