"""The answer to one observation with all that is said of it: by one category or the likeliest, with what to doubt."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np

from omad.common.errors import InputError
from omad.estimation.categories.late import AnyEstimator
from omad.estimation.categories.ranking import Ranking, rank, suspected
from omad.estimation.checks import (
    Check,
    believed,
    camera_doubts,
    doubts,
    gravity_doubts,
    if_also,
    is_doubtful,
    no_surer,
    scale_doubts,
)
from omad.estimation.estimate import Estimate
from omad.estimation.estimator import Estimator
from omad.estimation.known import NOTHING_KNOWN, Known
from omad.estimation.several_views import contradictions
from omad.sensing.observation import Observation

from .detection.cutting import ObjectFinder
from .detection.detector import Detector

OF_VIEW = ("size", "depth", "points", "frame")
"""Checks of what was seen, whatever the answer."""


@dataclass(frozen=True)
class Found:
    """The answer to one observation."""

    estimate: Estimate
    checks: list[Check]
    """What to look at, as something is doubtful."""
    ranking: Ranking | None = None
    """Of the likeliest categories, where they were compared."""
    none: bool = False
    """It is of none of the categories: the estimate is by the one that it is most like."""

    @classmethod
    def of(cls, estimate: Estimate, checks: list[Check], ranking: Ranking | None = None, none: bool = False) -> Self:
        """With the estimate as far as the checks let it be believed."""
        return cls(believed(estimate, checks), checks, ranking, none)

    @property
    def doubtful(self) -> bool:
        """Whether it is rather wrong than right."""
        return self.none or is_doubtful(self.estimate, self.checks)

    def with_seconds(self, read: float) -> Self:
        """With how long it took to ``read`` what was asked."""
        return replace(self, estimate=replace(self.estimate, seconds=self.estimate.seconds | {"read": read}))

    def to_dict(self) -> dict[str, Any]:
        """For JSON, as plain values."""
        return {**self.estimate.to_dict(), **self._doubts()}

    def none_of_them(self) -> dict[str, Any]:
        """What is said of a thing that is of none of the categories."""
        assert self.ranking is not None
        said = self.estimate.to_dict()
        nothing = {key: [] if isinstance(value, list) else None for key, value in said.items()}
        kept = {"T_camera_base": None, "converged": False, "seconds": said["seconds"], "warnings": said["warnings"]}
        return {**nothing, **kept, **self._doubts()}

    def _doubts(self) -> dict[str, Any]:
        ranked = {} if self.ranking is None else self.ranking.to_dict()
        return {"doubtful": self.doubtful, "checks": [check.to_dict() for check in self.checks], **ranked}


@dataclass(frozen=True)
class Solver:
    """Estimates with one category, or with the one of several that explains an observation best."""

    chosen: Estimator | None
    """Of the category asked for; None: of any."""
    load_all: Callable[[], Sequence[AnyEstimator]]
    """Those of all categories, with the one chosen; asked for where they are needed."""
    known: Known = NOTHING_KNOWN
    compare: bool = False
    """Compare with the other categories even where nothing is doubtful."""
    to_surface: bool = False
    """Answers go on towards their surfaces, once all is said of them."""

    def __call__(self, observation: Observation, depth_scale: float | None, further: bool = True) -> Found:
        """``depth_scale``: metres per number that it was read with, where known; ``further``: doubt also by further
        estimates. Raises InputError where there is no answer."""
        found = self._solve(observation, depth_scale, further)
        return replace(found, estimate=found.estimate.to_surface()) if self.to_surface and not found.none else found

    def _solve(self, observation: Observation, depth_scale: float | None, further: bool) -> Found:
        if self.chosen is None:
            ranking = rank(observation, self.all, self.known)
            if not ranking.candidates:
                raise InputError("is of none of the categories, at no size; check depth scale, mask and intrinsics")
            first = ranking.candidates[0]
            own = next(one for one in self.all if one.category.name == first.estimate.category.name)
            [answer] = own.reconsidered([observation], [first.estimate], self.known.of(own.category))
            best = no_surer(if_also(answer, first.probability), observation.likelihood)
            checks = doubts(observation, best, depth_scale)
            if further:
                checks += self._told_by_others(observation, answer, checks, own, depth_scale)
            return Found.of(best, checks, ranking, ranking.is_none)
        return self.judged(observation, self.chosen(observation, self.known), depth_scale, further)

    def _told_by_others(
        self,
        observation: Observation,
        estimate: Estimate,
        found: Sequence[Check],
        estimator: AnyEstimator,
        depth_scale: float | None,
    ) -> list[Check]:
        """What speaks against one of which so much was ``found``: what other estimates of its category say, without
        gravity, at other depth scales and with other focal lengths."""
        known = self.known.of(estimator.category)

        def again(views: list[Observation]) -> list[Estimate]:
            return estimator.first_answers(views, known)

        checks = gravity_doubts(observation, estimate, known, estimator)
        if not any(check.name == "size" for check in found):
            checks += scale_doubts(observation, believed(estimate, found), again, depth_scale)
        if all(check.name in ("residual", "probability") for check in (*found, *checks)):  # a wrong focal length's, too
            checks += camera_doubts(observation, estimate, again)
        return checks

    def judged(
        self, observation: Observation, estimate: Estimate, depth_scale: float | None, further: bool = True
    ) -> Found:
        """An ``estimate`` by the category asked for, with what to doubt of it; ``further``: also by estimates with
        other focal lengths and other categories. It is no surer than that the observation is of the object. Raises
        InputError where it is no answer."""
        chosen, ranking, answer = self.chosen, None, no_surer(estimate, observation.likelihood)
        assert chosen is not None
        checks = doubts(observation, estimate, depth_scale)
        if not estimate.is_finite:
            raise InputError(f"no answer: {checks[0]}")
        if not further:
            return Found.of(answer, checks)
        checks += self._told_by_others(observation, estimate, checks, chosen, depth_scale)
        odd_size = any(check.name == "size" for check in checks)  # of which every category says anything
        if (checks and not odd_size) or self.compare:
            ranking = rank(observation, self.all, self.known, always=[chosen.category.name])
            checks += suspected(estimate, ranking)
        return Found.of(answer, checks, ranking)

    def together(self, views: Sequence[Observation], poses: Sequence[Any], depth_scale: float | None) -> list[Found]:
        """Views of one object, by the category asked for; ``poses`` (4, 4) T_world_camera of each."""
        chosen, T_world_camera = self.chosen, np.stack(poses)
        assert chosen is not None
        estimates = chosen(views, self.known, T_world_camera=T_world_camera)
        # gravity is the first camera's
        of_all = gravity_doubts(
            views[0],
            estimates[0],
            self.known,
            lambda _, known: chosen(views, known, T_world_camera=T_world_camera)[0],
            alone=False,
        )
        rows = zip(views, estimates, strict=True)
        found = []
        for view, estimate in rows:
            against = [*contradictions(estimate)]  # the object is elsewhere then, and the rest says nothing of the view
            own = [check for check in doubts(view, estimate, depth_scale) if not against or check.name in OF_VIEW]
            checks = [*against, *own, *of_all]
            found.append(Found.of(no_surer(estimate, view.likelihood), checks))
        return found

    def find(self, frame: Observation, box: Sequence[float] | None) -> Observation:
        """The object in a whole frame. Raises InputError."""
        detector = Detector([self.chosen] if self.chosen else list(self.all), known=self.known)
        return ObjectFinder(detector)(frame, box)

    @cached_property
    def all(self) -> Sequence[AnyEstimator]:
        """Those of all categories."""
        return self.load_all()
