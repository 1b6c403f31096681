"""Put a trained network and its prior where the shipped weights are: the network in eight bits, the prior in sixteen.

    python benchmarks/tools/ship_weights.py RUN PRIOR
    python benchmarks/tools/ship_weights.py RUN          (of a network of all categories, which has no prior)

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
from omad.model.fronts import hands
from omad.model.fronts import network as fronts
from omad.model.proposals import network as proposals
from omad.model.storage.packing import halved, packed


def main(run: tyro.conf.Positional[Path], prior: tyro.conf.Positional[Path | None] = None) -> None:
    config = json.loads((run / "config.json").read_text())
    of_all = {"proposals": proposals.WEIGHTS, "fronts": fronts.WEIGHTS, "hands": hands.WEIGHTS}
    folder = of_all[config["kind"]] if prior is None else WEIGHTS / config["category"]["name"]
    folder.mkdir(exist_ok=True)
    write_tensors(packed(load_file(run / "model.safetensors")), folder)
    shutil.copy(run / "config.json", folder / "config.json")
    if prior is not None:
        write_tensors(halved(load_file(prior / "model.safetensors")), folder / "prior")
        shutil.copy(prior / "config.json", folder / "prior" / "config.json")
        (folder / "confidence.json").unlink(missing_ok=True)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
