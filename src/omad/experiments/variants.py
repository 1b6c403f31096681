"""What the ablation changes: of the prior, of the network's training, or of the estimator alone."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from ..categories import Category
from ..estimator import EstimatorConfig
from ..train_net import NetTraining
from ..views import ViewSettings


@dataclass(frozen=True)
class Trained:
    """A variant that needs a training of its own."""

    keypoints: float = 1.0
    """Times as many on each part."""
    basis: float = 1.0
    """Times as many numbers in beta."""
    training: NetTraining = NetTraining()
    config: EstimatorConfig = field(default_factory=EstimatorConfig)

    def category(self, category: Category) -> Category:
        """The category with as many; keypoints of a part stay even, since some parts are their own mirror."""
        parts = tuple(
            replace(part, keypoints=max(2 * round(self.keypoints * part.keypoints / 2), 2)) for part in category.parts
        )
        return replace(category, parts=parts, basis_size=max(round(self.basis * category.basis_size), 1))

    @property
    def prior(self) -> str:
        """Variants with the same prior share it."""
        return f"prior-{self.keypoints:g}-{self.basis:g}"


TRAINED = {
    "as it is": Trained(),
    "a third of the keypoints": Trained(keypoints=1 / 3),
    "twice the keypoints": Trained(keypoints=2),
    "a fifth of beta": Trained(basis=0.2),
    "half of beta": Trained(basis=0.5),
    "twice beta": Trained(basis=2),
    "no attention": Trained(training=NetTraining(attention=False)),
    "no noise in training": Trained(training=NetTraining(views=ViewSettings(noise=0.0))),
    "no second look": Trained(
        training=NetTraining(second_looks=0.0),
        config=EstimatorConfig(samples=(sum(EstimatorConfig().samples),)),
    ),
}
"""By name; the first is what the others are compared with."""

SETTINGS = {
    "as it is": EstimatorConfig(),
    "one look": EstimatorConfig(samples=(sum(EstimatorConfig().samples),)),
    "keypoints count alike": EstimatorConfig(confidence=False),
    "Adam, as in the paper": EstimatorConfig(method="adam"),
}
"""Of the estimator with one and the same network."""
