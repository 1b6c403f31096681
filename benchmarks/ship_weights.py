"""Put a trained network and its prior where the shipped weights are: the network in eight bits, the prior as it is.

    python benchmarks/ship_weights.py RUN PRIOR

Category and folder follow from the checkpoint. What was fitted to the weights that were there goes: fit it again
(``omad train confidence``).
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import tyro
from safetensors.torch import load_file

from omad.model.checkpoint import WEIGHTS, write_tensors
from omad.model.storage.packing import packed


def main(run: tyro.conf.Positional[Path], prior: tyro.conf.Positional[Path]) -> None:
    folder = WEIGHTS / json.loads((run / "config.json").read_text())["category"]["name"]
    # the prior's own numbers stay exact: they are compared with those in its folder
    write_tensors(packed(load_file(run / "model.safetensors")), folder)
    shutil.copy(run / "config.json", folder / "config.json")
    write_tensors(load_file(prior / "model.safetensors"), folder / "prior")
    shutil.copy(prior / "config.json", folder / "prior" / "config.json")
    (folder / "confidence.json").unlink(missing_ok=True)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
