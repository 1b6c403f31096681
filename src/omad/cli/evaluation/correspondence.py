"""``omad eval keypoints`` and ``views``."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

from tyro.conf import OmitArgPrefixes

from omad.common.lazy import lazy_imports

from ..answer import Answer
from ..options import CategoryCommand, Models, check_positive, load_prior, prior_of

with lazy_imports():
    from omad.common.runtime import pick_device
    from omad.evaluation.keypoint_spread import keypoint_spread
    from omad.evaluation.view_agreement import compare_views
    from omad.model.checkpoint import find_weights, is_checkpoint, load
    from omad.model.omadnet import OmadNet


@dataclass(frozen=True, kw_only=True)
class EvalKeypoints(CategoryCommand):
    """Show that keypoints correspond: how far each one's place in its part wanders between unseen objects."""

    weights: Path | None = None
    """Checkpoint folder of a prior, or with prior/ in it, in place of the shipped one."""
    data: OmitArgPrefixes[Models] = Models(objects=100)

    def run(self) -> Answer:
        check_positive(objects=self.data.objects)
        folder = self.weights or find_weights(self.category)
        net = (prior_of if is_checkpoint(folder / "prior") else load_prior)(folder, self.device)
        self.check_weights(net.category)
        return Answer(asdict(keypoint_spread(net, self.data.load(net.category).models)))


@dataclass(frozen=True, kw_only=True)
class EvalViews(CategoryCommand):
    """Show that training views are like rendered ones: the error of the network's first look on both."""

    data: OmitArgPrefixes[Models] = Models()
    views: int = 1000
    """Of each kind."""

    def run(self) -> Answer:
        check_positive(objects=self.data.objects, views=self.views)
        folder = find_weights(self.weights or self.category)
        net, priornet = load(OmadNet, folder).to(pick_device(self.device)), prior_of(folder, self.device)
        self.check_weights(net.category)
        models = self.data.load(net.category).models
        return Answer(asdict(compare_views(net, priornet, models, self.views, self.data.seed)))
