"""Finds the objects of a frame: planes are taken away, what is left falls into things, categories judge each thing."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from omad.common.arrays import as_doubles
from omad.common.errors import InputError
from omad.estimation.categories.late import AnyEstimator, LateEstimator
from omad.estimation.categories.proposals import Proposals
from omad.estimation.checks import scaled
from omad.estimation.estimate import Estimate, chance, plain
from omad.estimation.known import NOTHING_KNOWN, Known, check_is_known
from omad.geometry.rigid import box as bounds
from omad.geometry.rigid import diagonal
from omad.model.checkpoint import shipped_categories
from omad.model.proposals.network import Proposer, shipped_proposer
from omad.objects.category_file import get_category
from omad.objects.sizes import FACTORS, WrongScale, usual_size, wrong_scale
from omad.sensing.cutting.angles import angle_doubts, turn_doubts
from omad.sensing.cutting.not_depth import what_else
from omad.sensing.cutting.segmentation import TOUCHED, WITHIN, share_of_margin, things_alone, things_before_planes
from omad.sensing.observation import Observation
from omad.sensing.steadying import steadied

from .judgement import ODD_SIZE, Judgement, against, size_ratio

LEAST = 150
"""Points of the smallest thing that is looked at."""
SURE = 0.5
"""An object is of a category that is at least so likely; what reaches this for no category is none of them."""
SURE_OF_SCALE = 0.9
"""A thing is as likely an object, where another scale is believed for it ..."""
TRIED = 6
"""... by the largest of them, so many: of twenty things at eight scales each all would take half a minute."""
NONE = "none"
"""Of the categories, where they are names."""
MOST = 0.5
"""Where one thing holds more than this share of what a frame shows, it may be a table with all that is on it."""
WHOLE = 0.9
"""A thing of which less than this share lies in the box is cut by it."""
NO_PLANES = np.zeros((0, 4))
CLEAR = 8.0
"""What is so many times as high as the lowest thing that can be told from a plane is seen well enough."""


@dataclass(frozen=True, eq=False)
class Detection:
    """One thing that stands before table, floor and walls."""

    observation: Observation
    """Its points alone."""
    probabilities: dict[str | None, float]
    """Of each category, likeliest first; None: of none of them."""
    estimate: Estimate | None
    """By its category, of its steadied points; None where it is of none, or several share the probability."""
    evidence: dict[str, np.ndarray]
    """(13,) what speaks ``against`` each category that was fitted, of about its size, and proposed; its front last."""

    def __repr__(self) -> str:
        joints = "" if self.estimate is None else f": {', '.join(map(str, self.estimate.joints))}"
        return f"<Detection: {called(self.likely)} {chance(self.likely_probability)}{joints}>"

    @property
    def category(self) -> str | None:
        """None: none of those that were asked for, or several of them, which ``likely`` names."""
        return None if self.estimate is None else self.estimate.category.name

    @property
    def probability(self) -> float:
        """That it is of its category; without one, that it is of none."""
        return self.probabilities[self.category]

    @property
    def likely(self) -> tuple[str, ...]:
        """What it is, surely enough: its category, or ``NONE``; where some share the probability, as chests of four and
        of five drawers do, each of these, likeliest first."""
        names, sure = list[str](), 0.0
        for name, share in self.probabilities.items():
            if sure < SURE:
                names, sure = [*names, name or NONE], sure + share
        return tuple(names)

    @property
    def likely_probability(self) -> float:
        """That it is one of the ``likely``."""
        return sum(list(self.probabilities.values())[: len(self.likely)])

    @property
    def box(self) -> tuple[int, int, int, int] | None:
        """x1, y1, x2, y2 in pixels of the image that was given, half-open; None in a bare cloud."""
        if self.observation.given_pixels is None or self.observation.depth is None:
            return None
        (x1, y1), (x2, y2) = bounds(self.observation.given_pixels).tolist()
        height, width = self.observation.depth.shape
        each = self.observation.every  # rows and columns of a point
        return x1, y1, min(x2 + each, width), min(y2 + each, height)

    def to_dict(self) -> dict[str, Any]:
        """As JSON has it; ``centre`` is the middle of its seen points' box, metres, camera frame."""
        estimate = None if self.estimate is None else self.estimate.to_dict()
        return plain(
            {
                "category": self.category,
                "probability": self.probability,
                "likely": self.likely,
                "likely_probability": self.likely_probability,
                "probabilities": {name or NONE: value for name, value in self.probabilities.items()},
                "box": self.box,
                "points": len(self.observation.points),
                "centre": bounds(self.observation.points).mean(0),
                "estimate": estimate,
            }
        )


@dataclass(frozen=True, eq=False)
class Look:
    """What one look at a frame finds."""

    detections: list[Detection]
    """Objects first and the likeliest of them first."""
    lowest: float
    """Metres: what rises less over table, floor or wall at the middle distance cannot be told from it by depth."""
    too_flat: tuple[str, ...]
    """Those of the categories whose objects, laid flat, are about so low."""
    doubts: tuple[str, ...]
    """Of the camera, by how table, floor and walls stand to each other; and of these, where they may not be found."""
    planes: np.ndarray
    """(P, 4) n . p = d of points p, metres, camera frame, n towards the camera: table, floor and walls, the largest
    first."""
    alone: Sequence[Observation] = ()
    """What the detections may be instead, where the frame may have been cut out already: things before no planes."""

    @property
    def support_plane(self) -> np.ndarray | None:
        """(4,) of the largest plane."""
        return self.planes[0] if len(self.planes) else None


@dataclass(frozen=True)
class Detector:
    """Looks for objects of the categories whose estimators it has."""

    estimators: Sequence[AnyEstimator]
    """One for each category; those that load late are loaded where something may be of theirs."""
    judgement: Judgement = field(default_factory=Judgement.fitted)
    """How likely things are of these categories."""
    propose: Proposer = field(default_factory=shipped_proposer)
    """Which of them are worth fitting to a thing."""
    known: Known = NOTHING_KNOWN
    """Of all objects: gravity, where they stand upright."""

    def __post_init__(self) -> None:
        check_is_known(self.known)

    def __call__(self, frame: Observation, box: Sequence[float] | None = None) -> list[Detection]:
        """All things of a whole ``frame``, objects first and the likeliest of them first; within a ``box``
        (x1, y1, x2, y2) in pixels where one is given. Things that lie flat on a table cannot be told from it by depth,
        and things that touch are one. Raises InputError for a box of a bare cloud."""
        return self.look(frame, box).detections

    def look(self, frame: Observation, box: Sequence[float] | None = None) -> Look:
        """The same, with what cannot be found."""
        inside = None if box is None else frame.inside(box)
        turn = self.known.level_turn().astype(np.float32)  # of rolled cameras tables and their floors are found, too
        points = frame.points @ turn
        found = things_before_planes(points, LEAST)
        found, things = replace(found, planes=np.c_[found.planes[:, :3] @ turn.T, found.planes[:, 3]]), []
        seen = _of_box(frame, found.clusters, inside)
        judged = self._judged(seen, found.planes)
        if measured_margin(frame) < TOUCHED and len(found.planes):
            # cut out already, perhaps: then the planes were an object's own, and what is left of it looks like another
            things = _of_box(frame, things_alone(points, LEAST), inside)
            alone = self._judged(things, NO_PLANES)
            if shows_more(alone, judged):
                judged, found = alone, replace(found, planes=NO_PLANES)
        flat = tuple(e.category.name for e in self.estimators if _height(e) < CLEAR * found.lowest)
        turned = turn_doubts(found.planes) if self.known.gravity is None else ()
        doubts = (*_bent(frame), *angle_doubts(found.planes), *turned, *_unsupported(frame, found.planes, judged))
        return Look(judged, found.lowest, flat, doubts, found.planes, things)

    def scale_doubts(self, look: Look, depth_scale: float | None) -> Iterator[str]:
        """Where a wrong ``depth_scale``, metres per number where known, may be why nothing is of the categories: at
        another scale some things are objects, or most are of no object's size, whatever its category."""
        sizes = [diagonal(one.observation.points) for one in look.detections]
        if not sizes or any(one.category for one in look.detections):
            return
        what, best, scale = f"no object; of {len(sizes)} the largest is {max(sizes):.2g} m", 0.0, None
        for factor in FACTORS:
            sure = [one for one in self._at_scale(look, factor) if one.category and one.probability > SURE_OF_SCALE]
            if (score := sum(one.probability for one in sure)) > best:
                best, scale = score, WrongScale.of(factor, depth_scale)
                what = f"no object; at another scale {len(sure)} of {len(sizes)} would be"
        asked = [usual_size(estimator.category) for estimator in self.estimators]
        known = [*asked, *(usual_size(get_category(name)) for name in shipped_categories())]
        if scale is None and not min(known) / ODD_SIZE < np.median(sizes) < ODD_SIZE * max(known):
            scale = wrong_scale(max(sizes), float(np.median(asked)), depth_scale)
        if scale is not None:
            yield f"{what}: {scale.why}; {scale.cure}"

    def _at_scale(self, look: Look, factor: float) -> list[Detection]:
        """The largest things of a look as they would be judged in a frame so many times as large."""

        def judged(things: Iterable[Observation], planes: np.ndarray) -> list[Detection]:
            largest = sorted(things, key=lambda thing: len(thing.points))[-TRIED:]
            return self._judged([scaled(thing, factor) for thing in largest], planes)

        found = judged((one.observation for one in look.detections), look.planes * np.array([1, 1, 1, factor]))
        alone = judged(look.alone, NO_PLANES)
        return alone if shows_more(alone, found) else found

    def whole(self, frame: Observation) -> Detection:
        """All of a frame as one thing, without table, floor and walls."""
        return self._judged([frame], NO_PLANES)[0]

    def _judged(self, seen: Sequence[Observation], planes: np.ndarray) -> list[Detection]:
        """Each of the things that were ``seen`` before ``planes`` (P, 4)."""
        steady = [steadied(thing) for thing in seen]
        names = [estimator.category.name for estimator in self.estimators]
        upright = [self.known.as_level(thing) for thing in steady]
        proposals = [Proposals.of(look, names) for look in self.propose(upright)]
        chosen = [self._worth_fitting(*each) for each in zip(steady, proposals, strict=True)]
        evidence: list[dict[str, np.ndarray]] = [{} for _ in seen]
        estimates: list[dict[str, Estimate]] = [{} for _ in seen]
        for estimator, name in zip(self.estimators, names, strict=True):
            rows = [i for i, few in enumerate(chosen) if name in few]
            known = self.known.of(estimator.category)
            found = estimator.first_answers([steady[i] for i in rows], known) if rows else []
            for i, estimate in zip(rows, found, strict=True):
                if not estimate.is_finite:  # no candidate at all
                    continue
                evidence[i][name] = against(steady[i], estimate, estimator.net.prior, planes, proposals[i].doubt(name))
                estimates[i][name] = estimate
        detections = []
        by_name = dict(zip(names, self.estimators, strict=True))
        for thing, shown, before, candidates in zip(seen, steady, evidence, estimates, strict=True):
            numbers = self.judgement.with_fronts(before, candidates)
            probabilities = self.judgement.probabilities(numbers)
            best = max(candidates, key=lambda name: probabilities[name], default=None)
            sure = best is not None and probabilities[best] >= SURE
            estimate = None
            if best is not None and sure:
                known = self.known.of(by_name[best].category)
                [estimate] = by_name[best].reconsidered([shown], [candidates[best]], known)
            detections.append(Detection(thing, probabilities, estimate, numbers))
        return sorted(detections, key=lambda found: (found.category is None, -found.probability))

    def _worth_fitting(self, thing: Observation, proposals: Proposals) -> list[str]:
        """Of the categories whose objects are about as large as the thing."""
        ratios = {one.category.name: size_ratio(thing.points, one.category) for one in self.estimators}
        return proposals.worth_fitting([name for name, ratio in ratios.items() if 1 / ODD_SIZE < ratio < ODD_SIZE])


def detect(
    seen: Any,
    K: Any = None,
    categories: str | Path | Iterable[str | Path] = (),
    box: Sequence[float] | None = None,
    known: Known = NOTHING_KNOWN,
) -> list[Detection]:
    """All objects of an ``Observation`` of a whole frame, or of a depth image (H, W) in metres, as
    ``Observation.from_depth`` takes it with ``K``: what stands on a table or floor, each with its category of
    ``categories`` (one or several; default: all with shipped weights), its estimate and how sure that is. What is of
    none of them is among the answers, too. ``box``, ``known``: as of ``Detector``. Raises InputError."""
    if isinstance(seen, Observation) and K is not None:
        raise InputError("K: an Observation has its camera; leave K out")
    frame = seen if isinstance(seen, Observation) else Observation.from_depth(seen, K)
    given = [categories] if isinstance(categories, str | Path) else categories
    names = tuple(given) if isinstance(given, Iterable) else (None,)
    if not all(isinstance(name, str | Path) for name in names):
        raise InputError("categories: must be names or checkpoint folders, one or several")
    return replace(_detector(tuple(map(str, names)) or tuple(shipped_categories())), known=known)(frame, box)


@cache
def _detector(categories: tuple[str, ...]) -> Detector:
    return Detector([LateEstimator.of(name) for name in categories])


def called(likely: Sequence[str]) -> str:
    """``Detection.likely`` in words."""
    names = ["none of these" if name == NONE else name for name in likely]
    return " or ".join(names) + "?" * (len(names) > 1)


def measured_margin(frame: Observation) -> float:
    """As ``share_of_margin`` of a depth image; 0 of a bare cloud."""
    return 0.0 if frame.mask is None else share_of_margin(frame.mask)


def _bent(frame: Observation) -> Iterator[str]:
    """Where depth images hold something else."""
    if measured_margin(frame) >= TOUCHED and (held := what_else(frame.points)) is not None:
        yield str(held)


def _unsupported(frame: Observation, planes: np.ndarray, judged: Sequence[Detection]) -> Iterator[str]:
    """What speaks for a table, floor or wall that was not told from what stands on it, among ``planes`` (P, 4); nothing
    where the frame shows what was cut out already."""
    if measured_margin(frame) < TOUCHED:
        return
    so = "what stands on it is one thing with it: give omad estimate a mask"
    share = max((len(one.observation.points) for one in judged if one.category is None), default=0) / len(frame.points)
    if not len(planes):
        yield f"no table, floor or wall was found; where there is one, {so}"
    elif share > MOST:
        yield f"a thing of none of the categories holds {share:.0%} of what the frame shows; if that is a table, {so}"


def shows_more(judged: Sequence[Detection], than: Sequence[Detection]) -> bool:
    """Whether the likeliest object is likelier, and all objects have more points."""
    return bool((_shown(judged) > _shown(than)).all())


def _shown(judged: Sequence[Detection]) -> np.ndarray:
    """(2,) how likely the likeliest object is, and how many points all objects have."""
    objects = [one for one in judged if one.category]
    sure = max((one.probability for one in objects), default=0.0)
    return np.array([sure, sum(len(one.observation.points) for one in objects)])


def _of_box(frame: Observation, things: Sequence[np.ndarray], inside: np.ndarray | None) -> list[Observation]:
    """The things of a ``frame`` that a box is about, points ``inside`` (N,) of it: those that mostly lie in it, or
    where there are none, as the thing touches others, all that reaches inside. Warns of what the box cuts off."""
    if inside is None:
        return [frame.part(thing) for thing in things]
    cut = [(thing[inside[thing]], len(thing)) for thing in things]
    cut = [(part, of) for part, of in cut if len(part) >= LEAST]
    chosen = [(part, of) for part, of in cut if len(part) >= WITHIN * of] or cut
    seen = []
    for part, of in chosen:
        beyond = f"{1 - len(part) / of:.0%} of what was found in the box lies outside of it, and was left out"
        told = (f"{beyond}: give a larger box where that is the object's",) if len(part) < WHOLE * of else ()
        seen.append(frame.part(part).warned(*told))
    return seen


def _height(estimator: AnyEstimator) -> float:
    """Metres, of the category's mean object at rest."""
    prior = estimator.prior if isinstance(estimator, LateEstimator) else estimator.net.prior
    keypoints = as_doubles(prior.keypoints(prior.beta_mean[None]).detach()[0])
    return float(np.ptp(keypoints[:, 1])) * estimator.category.metres_per_unit
