"""From the fit to what a caller gets: metres, radians, and how sure each number is."""

from functools import cached_property

import numpy as np
import torch

from omad.common.arrays import as_doubles, as_numpy
from omad.common.errors import InputError
from omad.model.fitting.posed_object import Poser
from omad.model.fitting.state import Refined, State
from omad.model.prior import OmadPrior
from omad.model.surfaces.surfaces import Surfaces
from omad.objects.category import Category

from ..checks import network_doubts, part_doubts, size_doubts
from ..confidence.model import SHARED, Confidence
from ..confidence.signals import IMAGE, WITHOUT_FRONT, Meter, Signals
from ..estimate import Estimate, PoseEstimate
from .look import Look
from .shown import Shown

CURE = "run omad train confidence anew, or put surfaces.npz back"


class Answers:
    """Of one category's objects, as a prior has them."""

    def __init__(
        self, category: Category, prior: OmadPrior, confidence: Confidence | None, surfaces: Surfaces | None
    ) -> None:
        self._category, self._prior, self._confidence, self.surfaces = category, prior, confidence, surfaces
        self.asked = WITHOUT_FRONT if confidence is None else confidence.image
        if self.asked == IMAGE and surfaces is None:
            raise InputError(
                f"{category.name}: its confidence.json asks for surfaces.npz, which is not beside it; {CURE}"
            )
        self.shared = SHARED if confidence is None else confidence.shared
        self._meter = Meter(category, prior)

    @cached_property
    def posed(self) -> Poser:
        """Puts objects where states say."""
        return Poser(self._prior, self._category)

    def __call__(
        self, shown: Shown, first: Look, last: Look, refined: Refined, seconds: dict[str, float]
    ) -> list[Estimate]:
        """To B observations that were ``shown``, at which the ``first`` and the ``last`` look were taken, whose targets
        were fitted."""
        category, unit, joints = self._category, self._category.metres_per_unit, len(self._category.joints)
        scale = category.tangent_units(self._prior.basis_size)
        covariance = as_doubles(refined.covariance) * (scale[:, None] * scale)
        # the fit's answers and the network's own, whose deviations are not known
        rows = torch.cat([refined.state.pack(), first.state.pack()])
        posed = self.posed(State.unpack(rows, joints))
        batch = len(posed) // 2
        clouds = shown.clouds[:, -last.samples :]
        signals = self._meter(
            shown.observations, clouds, last.frame, last.said, last.targets, refined, posed[:batch], self.asked,
            self.surfaces,
        )  # fmt: skip
        std, tail, base_std, probability = self._judged(signals, covariance)
        final = PoseEstimate.of(category, posed[:batch], std, tail)
        initial = PoseEstimate.of(category, posed[batch:], np.full_like(std, np.nan), np.ones_like(std))
        converged, residual = refined.converged.tolist(), (refined.residual * unit).tolist()
        keypoint_std = unit / np.sqrt(as_doubles(last.targets.weights))
        observed = as_doubles(last.targets.keypoints) * unit
        logits, own_signals = as_numpy(last.part_logits), signals.rows()
        estimates = []
        # copies of what is large: who keeps one answer keeps nothing of all others
        for b, observation in enumerate(shown.observations):
            labelled = shown.labelled(b, logits[b].copy())
            doubts = [
                *size_doubts(observation, category),
                *network_doubts(keypoint_std[b], category),
                *part_doubts(labelled.shares, category),
            ]
            estimates.append(
                Estimate(
                    **vars(final[b]),
                    category=category,
                    observed_keypoints=observed[b],
                    keypoint_std=keypoint_std[b],
                    covariance=covariance[b].copy(),
                    base_std=base_std[b].copy(),
                    converged=converged[b],
                    residual=residual[b],
                    labelled=labelled,
                    initial=initial[b],
                    signals=own_signals[b],
                    probability=probability[b],
                    seconds=dict(seconds),
                    warnings=(*observation.warnings, *map(str, doubts)),
                    surfaces=self.surfaces,
                )
            )
        return estimates

    def _judged(
        self, signals: Signals, covariance: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[float] | list[None]]:
        """``state_std`` (B, J), ``tail`` (B, J), ``base_std`` (B, 6) and ``probability`` of B answers that have the
        covariances (B, P, P) by least squares; states that were held fixed keep their zero."""
        least, base = state_std(covariance, self._category), base_std(covariance)
        if self._confidence is None:
            return least, np.ones_like(least), base, [None] * len(least)
        found, tail = self._confidence.spreads(signals, self._category)
        told = np.where(least == 0, 0.0, found)
        base = self._confidence.base_spreads(base, least, told)
        return told, tail, base, self._confidence.probabilities(signals).tolist()


def state_std(covariance: np.ndarray, category: Category) -> np.ndarray:
    """(B, J) of covariances (B, P, P)."""
    variance = covariance.diagonal(axis1=1, axis2=2)[:, 6 : 6 + len(category.joints)]
    return np.sqrt(np.clip(variance, 0, None))


def base_std(covariance: np.ndarray) -> np.ndarray:
    """(B, 6) of covariances (B, P, P)."""
    return np.sqrt(np.clip(covariance.diagonal(axis1=1, axis2=2)[:, :6], 0, None))
