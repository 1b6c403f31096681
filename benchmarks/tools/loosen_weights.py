"""Let the betas of shipped weights end in loose numbers, which move pivots alone, as those of newly trained priors do.

    python benchmarks/tools/loosen_weights.py CATEGORY ... [--objects 1000]

Nothing else of prior and network changes. What was fitted to their answers is fitted again (``omad train confidence``).
"""

from __future__ import annotations

import tyro
from safetensors.torch import load_file

from omad.data.source import load_objects
from omad.data.surface_bank import SurfaceBank
from omad.model.checkpoint import WEIGHTS, load, write_tensors
from omad.model.object_prior import object_keypoints
from omad.model.priornet import PriorNet
from omad.objects.category_file import get_category
from omad.training.train_prior import PriorTraining, loosen_pivots, stretched_objects

LOOSENED = ("pivot_basis", "beta_mean", "beta_covariance")


def main(categories: tyro.conf.Positional[tuple[str, ...]], objects: int = 1000) -> None:
    for name in categories:
        folder, category = WEIGHTS / name, get_category(name)
        net = load(PriorNet, folder / "prior")
        bank = SurfaceBank.from_models(load_objects("procedural", category, objects, "train", 0, "refuse"), category)
        nodes, joints = stretched_objects(object_keypoints(net, bank), bank, PriorTraining().scale)
        net.prior.loosen(net.prior.pivot_basis[..., :0])
        loosen_pivots(net.prior, net.prior.encode(nodes), joints)
        numbers = {f"prior.{key}": getattr(net.prior, key).contiguous() for key in LOOSENED}
        for place in (folder, folder / "prior"):
            write_tensors(load_file(place / "model.safetensors") | numbers, place)
        print(f"{name}: {net.prior.pivot_basis.square().sum((0, 1)).sqrt().tolist()} units")


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
