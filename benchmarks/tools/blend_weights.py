"""Take a network part of the way from the one its training began with: what it learnt last is then worth more on
objects unlike the generated ones (Wortsman et al., Robust fine-tuning of zero-shot models, CVPR 2022).

    python benchmarks/tools/blend_weights.py RUN INITIAL --share 0.6 --output BLENDED

INITIAL is the folder of the checkpoint that RUN's training was given as ``--initial``.
"""

from __future__ import annotations

from pathlib import Path

import torch
import tyro

from omad.model import checkpoint
from omad.model.omadnet import OmadNet


def main(run: tyro.conf.Positional[Path], initial: tyro.conf.Positional[Path], share: float, output: Path) -> None:
    net, start = checkpoint.load(OmadNet, run), checkpoint.load(OmadNet, initial).state_dict()
    with torch.no_grad():
        for name, tensor in net.state_dict().items():
            if tensor.is_floating_point():
                tensor.lerp_(start[name], 1 - share)
    output.mkdir(parents=True, exist_ok=True)
    checkpoint.save(net, output, checkpoint.training_record(OmadNet, run) | {"blended": share})


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
