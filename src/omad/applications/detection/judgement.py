"""How likely a thing is of each category, or of none: a softmax over what speaks against them.

Its weights were fitted by maximum likelihood to things cut out of tables and floors with objects of the training split,
boxes and cans (``benchmarks/accuracy/bench_detect.py --fit --scenes 60 --seed 1``, which writes them to
``judgement.json``).
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Self

import numpy as np
from scipy.spatial import ConvexHull

from omad.common.files import write_json
from omad.estimation.categories.fronts import front_says
from omad.estimation.estimate import Estimate
from omad.estimation.evidence import explanation, measure_evidence
from omad.estimation.part_labels import OUTSIDE
from omad.geometry.rigid import diagonal
from omad.model.fronts.network import shipped_front_net
from omad.model.prior import OmadPrior
from omad.objects.category import Category
from omad.objects.sizes import usual_size
from omad.sensing.observation import Observation

FITTED = Path(__file__).with_name("judgement.json")
ODD_SIZE = 3.5
"""What is so many times larger or smaller than usual is none of the category."""
DOUBT = 8.0
"""The most that a front says against a category."""
LYING = 0.5
"""Of the tilt, one less its cosine: what is tilted by 60 degrees or more does not stand."""


def size_ratio(points: np.ndarray, category: Category) -> float:
    """Size of a cloud (N, 3) in metres, in units of the category's usual one."""
    return diagonal(points) / usual_size(category)


def against(thing: Observation, estimate: Estimate, prior: OmadPrior, planes: np.ndarray, doubt: float) -> np.ndarray:
    """(12,) what speaks against the category by whose network and ``prior`` a thing was estimated; grows as it fits
    worse. ``planes`` (P, 4) are those of table, floor and walls, n . p = d, n towards the camera; ``doubt`` is that of
    ``Proposals``."""
    evidence, explained = measure_evidence(thing, estimate, prior), explanation(thing, estimate)
    fit = [evidence.unsure, evidence.shape_mahalanobis, evidence.uncovered, evidence.unseen]
    odd_size = math.log(max(size_ratio(thing.points, estimate.category), 1e-6)) ** 2
    outside = math.sqrt(float((estimate.part_labels == OUTSIDE).mean()))
    stands = [_solidity(estimate), outside, _tilt(estimate, planes), doubt]
    return np.array([*fit, odd_size, *stands, explained.in_front, explained.behind, explained.missing])


def _tilt(estimate: Estimate, planes: np.ndarray) -> float:
    """By how much the object does not stand upright on any of the planes: 0 upright, ``LYING`` at most."""
    up = estimate.T_camera_base[:3, 1]
    return float(min(1 - (planes[:, :3] @ up).max(initial=-1), LYING)) if len(planes) else 0.0


def _solidity(estimate: Estimate) -> float:
    """Volume of the estimated object's parts as a share of that of their common hull: near one for a closed dishwasher,
    which any box looks like; an open one looks like nothing else."""
    parts = [mesh.vertices for mesh in estimate.hull_model().posed(estimate.joint_states)]
    whole, *each = (ConvexHull(points, qhull_options="QJ").volume for points in (np.concatenate(parts), *parts))
    return min(sum(each) / max(whole, 1e-12), 1.0)


@dataclass(frozen=True)
class Judgement:
    """Weights of the evidence, by the names of categories: their networks differ in how sure they are."""

    weights: Mapping[str, Sequence[float]]
    """(13,) log-odds per unit of what ``against`` returns, and of what ``with_fronts`` adds."""
    offsets: Mapping[str, float]
    """Log-odds of a category over none where nothing speaks against it."""

    @classmethod
    def fitted(cls) -> Self:
        """That of the shipped weights."""
        return cls(**json.loads(FITTED.read_text(encoding="utf-8")))

    def with_fronts(self, evidence: Mapping[str, np.ndarray], answers: Mapping[str, Estimate]) -> dict[str, np.ndarray]:
        """What speaks ``against`` the categories of ``answers`` with what the object's front says against each, (13,);
        nothing against those that its network does not know."""
        net = shipped_front_net()
        known = [name for name in evidence if name in net.names]
        scores = np.array([self._score(name, evidence[name]) for name in known])
        doubts = dict.fromkeys(evidence, 0.0)
        if np.isfinite(scores).any():
            says = front_says([answers[name] for name in known], scores, net)
            doubts |= dict(zip(known, np.minimum(-says, DOUBT), strict=True))
        return {name: np.append(values, doubts[name]) for name, values in evidence.items()}

    def probabilities(self, evidence: Mapping[str, np.ndarray]) -> dict[str | None, float]:
        """Of the categories whose evidence (13,) is given by their names, and of none of them (None); likeliest first.
        A category of one's own has the mean weights of the known ones."""
        scores: dict[str | None, float] = {None: 0.0}
        for name, values in evidence.items():
            scores[name] = self._score(name, values)
        highest = max(scores.values())
        odds = {name: math.exp(score - highest) for name, score in scores.items()}
        total = sum(odds.values())
        return {name: odds[name] / total for name in sorted(odds, key=lambda name: -odds[name])}

    def _score(self, name: str, values: np.ndarray) -> float:
        alike = [name] if name in self.offsets else list(self.offsets)
        weights = np.mean([self.weights[one] for one in alike], axis=0)
        score = float(np.mean([self.offsets[one] for one in alike]) - values @ weights[: len(values)])
        return score if math.isfinite(score) else -math.inf

    def save(self, path: Path = FITTED) -> None:
        """Write the file that ``fitted`` reads."""
        write_json(path, asdict(self))
