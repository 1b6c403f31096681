"""How long A-NCSH's alignment takes: RANSAC of every part, votes, and the refinement that joints hold together.

    OMP_NUM_THREADS=2 python benchmarks/speed/bench_ancsh.py [--category drawer] [--json]

No weights are needed: what a network would say is the truth of drawn views, with noise on every coordinate and a share
of points that are wrong altogether. Medians per image, one at a time and in a batch; errors say that it still works.
"""

from __future__ import annotations

import json
import platform
from dataclasses import dataclass

import numpy as np
import torch
import tyro
from bench_refinement import median_ms

from omad.data.procedural import generate
from omad.data.surface_bank import SurfaceBank
from omad.data.training_views import ViewBatch, ViewSettings, draw_views
from omad.evaluation.baselines.ancsh.alignment import Alignment, AlignmentConfig, align
from omad.evaluation.baselines.ancsh.coordinates import Coordinates, part_boxes, true_coordinates
from omad.evaluation.baselines.ancsh.net import AncshPrediction
from omad.geometry.kinematics import part_transforms
from omad.geometry.transforms import rotation_angle
from omad.objects.builtin import builtin_names
from omad.objects.category import Category
from omad.objects.category_file import get_category


@dataclass(frozen=True)
class Config:
    """Settings of the benchmark."""

    category: str | None = None
    """Default: all built-in ones."""
    views: int = 32
    points: int = 1536
    """Of a view: three samples of the slim network's 512."""
    noise: float = 0.02
    """Of coordinates, as a share of the part."""
    outliers: float = 0.1
    """Share of points that are placed anywhere."""
    json: bool = False


def disturbed(truth: Coordinates, category: Category, config: Config) -> AncshPrediction:
    """What a network might say."""
    draw = torch.Generator().manual_seed(0)
    B, N = truth.labels.shape
    K = len(category.parts)

    def noisy(values: torch.Tensor) -> torch.Tensor:
        return values + config.noise * torch.randn(values.shape, generator=draw)

    npcs = noisy(truth.npcs)
    wrong = torch.rand(B, N, 1, generator=draw) < config.outliers
    npcs = torch.where(wrong, torch.rand(npcs.shape, generator=draw) - 0.5, npcs)
    return AncshPrediction(
        part_logits=torch.nn.functional.one_hot(truth.labels, K).float(),
        npcs=npcs[:, :, None].expand(-1, -1, K, -1),
        sizes=noisy(truth.sizes[:, None].expand(B, N, K)).clamp(min=0.02),
        centres=noisy(truth.centres[:, None].expand(B, N, K, 3)),
        heat=noisy(truth.heat).clamp(0, 1),
        towards=torch.nn.functional.normalize(noisy(truth.towards), dim=-1),
        axes=torch.nn.functional.normalize(noisy(truth.axes[:, None].expand(B, N, -1, 3)), dim=-1),
    )


def measure(category: Category, config: Config) -> dict[str, float]:
    """Times and median errors of one category."""
    bank = SurfaceBank.from_models([generate(category, i) for i in range(4)], category)
    settings = ViewSettings(points=config.points, noise=0.0)
    views = draw_views(bank, category, config.views, settings, torch.Generator().manual_seed(0))
    said = disturbed(true_coordinates(views, part_boxes(bank, len(category.parts)), category), category, config)

    def run(rows: slice) -> Alignment:
        some = AncshPrediction(**{name: values[rows] for name, values in vars(said).items()})
        return align(views.points[rows], some, category, AlignmentConfig())

    one = median_ms(lambda i: run(slice(i, i + 1)), config.views)
    batch = median_ms(lambda _: run(slice(0, 16)), 3) / min(16, config.views)
    return {"one_ms": one, "batch_ms_each": batch, **errors(run(slice(None)), views, category)}


def errors(found: Alignment, views: ViewBatch, category: Category) -> dict[str, float]:
    G = part_transforms(category.tree, views.axes, views.pivots, views.states, views.T_camera_base)
    known = found.found[:, 1:] & found.found[:, list(category.tree.parents)]
    turn, state = {}, {}
    for name, poses in (("separate", found.separate), ("joined", found.joined)):
        rotation = rotation_angle(poses.T_camera_part[..., :3, :3].float(), G[..., :3, :3])[found.found]
        turn[f"rotation_deg_{name}"] = float(np.degrees(rotation.median().item()))
        state[f"state_{name}"] = float((poses.states - views.states)[known].abs().median())
    return {**turn, **state, "missing_parts": float((~found.found).float().mean())}


def main(config: Config) -> None:
    names = [config.category] if config.category else builtin_names()
    answer = {
        "machine": f"{platform.processor() or platform.machine()}, {torch.get_num_threads()} thread(s)",
        **{name: measure(get_category(name), config) for name in names},
    }
    print(json.dumps(answer) if config.json else "\n".join(f"{key}: {value}" for key, value in answer.items()))


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
