"""Estimators that load their weights when they are first asked: of many categories, few are."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Self, TypeAlias, overload

import numpy as np

from omad.common.runtime import undrawn
from omad.model.checkpoint import category_of, find_weights, load_part, shipped_categories
from omad.model.omadnet import OmadNet
from omad.model.prior import OmadPrior
from omad.model.surfaces.surfaces import Surfaces
from omad.objects.category import Category
from omad.sensing.observation import Observation

from ..estimate import Estimate
from ..estimator import Estimator, EstimatorConfig
from ..known import NOTHING_KNOWN, Known, Near


@dataclass(frozen=True)
class LateEstimator:
    """Stands for an estimator; what it is of is known before its weights are loaded."""

    category: Category
    """What it estimates."""
    folder: Path
    """Of its checkpoint."""
    device: str
    """Where its network runs."""
    config: EstimatorConfig | None = None
    """How it looks."""

    @classmethod
    def of(cls, weights: str | Path, device: str = "cpu", config: EstimatorConfig | None = None) -> Self:
        """That of a category with shipped weights, or of a checkpoint folder. Raises InputError."""
        folder = find_weights(weights)
        return cls(category_of(OmadNet, folder), folder, device, config)

    @cached_property
    def loaded(self) -> Estimator:
        """The estimator itself."""
        return Estimator.from_pretrained(self.folder, self.device, self.config)

    @cached_property
    def prior(self) -> OmadPrior:
        """Its network's prior, for which no more of the weights is loaded."""
        with undrawn():
            return load_part(OmadPrior(self.category), "prior.", self.folder)

    @property
    def net(self) -> OmadNet:
        """Its network."""
        return self.loaded.net

    @property
    def surfaces(self) -> Surfaces | None:
        """As ``Estimator`` has them."""
        return self.loaded.surfaces

    def near(self, observation: Observation, near: Near, known: Known = NOTHING_KNOWN) -> Estimate:
        """As ``Estimator`` does."""
        return self.loaded.near(observation, near, known)

    def moved(self, estimate: Estimate, state: Near, covariance: np.ndarray) -> Estimate:
        """As ``Estimator`` does."""
        return self.loaded.moved(estimate, state, covariance)

    @overload
    def __call__(self, observation: Observation, known: Known = NOTHING_KNOWN) -> Estimate: ...
    @overload
    def __call__(
        self, observation: Sequence[Observation], known: Known = NOTHING_KNOWN, T_world_camera: Any = None
    ) -> list[Estimate]: ...
    def __call__(
        self, observation: Observation | Sequence[Observation], known: Known = NOTHING_KNOWN, T_world_camera: Any = None
    ) -> Estimate | list[Estimate]:
        """As ``Estimator`` does."""
        return self.loaded(observation, known, T_world_camera)  # pyright: ignore[reportArgumentType, reportCallIssue]

    def first_answers(self, observations: Sequence[Observation], known: Known = NOTHING_KNOWN) -> list[Estimate]:
        """As ``Estimator`` has them."""
        return self.loaded.first_answers(observations, known)

    def reconsidered(
        self, observations: Sequence[Observation], estimates: Sequence[Estimate], known: Known = NOTHING_KNOWN
    ) -> list[Estimate]:
        """As ``Estimator`` does."""
        return self.loaded.reconsidered(observations, estimates, known)


AnyEstimator: TypeAlias = Estimator | LateEstimator


def shipped_estimators(device: str = "cpu", config: EstimatorConfig | None = None) -> list[LateEstimator]:
    """Those of all categories with shipped weights."""
    return [LateEstimator.of(name, device, config) for name in shipped_categories()]
