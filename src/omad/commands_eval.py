"""The evaluation commands."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

from .checkpoint import find_weights, load_net, load_priornet
from .estimator import Estimator, EstimatorConfig
from .evaluation import draw_worst, evaluate, summary
from .files import make_folder
from .keypoint_check import keypoint_spread
from .options import BrokenFiles, CategoryName, Device, Json, Result, Seed, Weights, check_category, check_positive
from .runtime import pick_device
from .sources.select import load_models, load_views
from .view_check import compare_views


@dataclass(frozen=True)
class EvalPose:
    """Measure pose, joint states and joint axes on views of unseen objects, before and after refinement."""

    category: CategoryName
    source: str = "procedural"
    """procedural, a folder of URDF / PartNet-Mobility models, an ArtImage root (its test split), or a folder that
    ``omad render`` made."""
    objects: int = 20
    """Procedural objects."""
    views: int = 200
    """In total, dealt out to the objects; of a rendered folder or an ArtImage root always all."""
    seed: Seed = 0
    depth_noise: bool = False
    """Simulate the depth camera's noise; a rendered folder has its own."""
    broken: BrokenFiles = "refuse"
    method: Literal["least_squares", "adam"] = "least_squares"
    """How to refine; adam: the paper's own recipe, for comparison."""
    pictures: Path | None = None
    """Folder for pictures of the worst views."""
    weights: Weights = None
    device: Device = "cpu"
    json: Json = False

    def run(self) -> Result:
        check_positive(objects=self.objects, views=self.views)
        config = EstimatorConfig(method=self.method)
        estimator = Estimator.from_pretrained(self.weights or self.category, self.device, config)
        category = estimator.category
        check_category("--weights", self.weights, category, self.category)
        if self.pictures is not None:
            make_folder(self.pictures)
        source = load_views(self.source, category, self.objects, self.views, self.seed, self.depth_noise, self.broken)
        results = evaluate(estimator, source.views, source.total)
        answer = summary(results, category, self.source) | {"depth_noise": source.noisy, "refused": source.refused}
        if self.pictures is not None:
            answer["pictures"] = draw_worst(results, category, self.pictures)
        return (1 if answer["failures"] == len(results) else 0), answer


@dataclass(frozen=True)
class EvalKeypoints:
    """Show that keypoints correspond: how far each one's place in its part wanders between unseen objects."""

    category: CategoryName
    source: str = "procedural"
    """procedural, or a folder of URDF / PartNet-Mobility models."""
    objects: int = 100
    """Procedural objects."""
    seed: Seed = 0
    weights: Weights = None
    """Prior checkpoint folder in place of the shipped one."""
    device: Device = "cpu"
    json: Json = False

    def run(self) -> Result:
        check_positive(objects=self.objects)
        net = load_priornet(self.weights or find_weights(self.category) / "prior").to(pick_device(self.device))
        check_category("--weights", self.weights, net.category, self.category)
        models = load_models(self.source, net.category, self.objects, "test", self.seed).models
        return 0, asdict(keypoint_spread(net, models))


@dataclass(frozen=True)
class EvalViews:
    """Show that training views are like rendered ones: the error of the network's first look on both."""

    category: CategoryName
    source: str = "procedural"
    """procedural, or a folder of URDF / PartNet-Mobility models."""
    objects: int = 20
    """Procedural objects."""
    views: int = 1000
    """Of each kind."""
    seed: Seed = 0
    weights: Weights = None
    device: Device = "cpu"
    json: Json = False

    def run(self) -> Result:
        check_positive(objects=self.objects, views=self.views)
        folder, device = find_weights(self.weights or self.category), pick_device(self.device)
        net, priornet = load_net(folder).to(device), load_priornet(folder / "prior").to(device)
        check_category("--weights", self.weights, net.category, self.category)
        models = load_models(self.source, net.category, self.objects, "test", self.seed).models
        return 0, asdict(compare_views(net, priornet, models, self.views, self.seed))
