"""The one object that is asked for, cut out of a whole frame where no mask says which it is."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from omad.common.errors import NothingSeen
from omad.geometry.rigid import diagonal
from omad.objects.sizes import usual_size, wrong_scale
from omad.sensing.cutting.segmentation import TOUCHED, things_before_planes
from omad.sensing.observation import Observation

from .detector import LEAST, SURE, Detection, Detector, called, measured_margin
from .judgement import ODD_SIZE, size_ratio

MEASURED = 0.4
"""Share of the margin that is measured in frames that show more than an object; ``TOUCHED`` in those that show things
too large for one."""
LIKELY = 0.2
"""A thing less likely than this is not taken for the object, unless a box says so."""
MOST = 0.75
"""Where one thing holds this share of what a frame shows, there is nothing beyond it."""
ALONE = 0.8
"""So likely an object, all that a frame shows is it."""


@dataclass(frozen=True)
class ObjectFinder:
    """Takes of a frame's things the one that the detector's categories explain best."""

    detector: Detector

    def __call__(self, frame: Observation, box: Sequence[float] | None = None) -> Observation:
        """The object of a whole ``frame``, with warnings where it is doubtful or not the only one; of what lies in the
        ``box`` (x1, y1, x2, y2) where one is given. A frame that shows an object and no surroundings is left as it is;
        one that may show a little of them only where that explains it better than one of its things does.
        Raises NothingSeen where no thing is such an object, InputError for a box that is wrong."""
        alone = self._alone(frame, box)
        as_one = 0.0 if alone is None else self._likelihood_as_one(alone)
        if alone is not None and as_one >= ALONE:
            return alone
        look = self.detector.look(frame, box)
        things = look.detections
        several = len(self.detector.estimators) > 1
        names = "object of the categories" if several else self.detector.estimators[0].category.name
        where = "before table, floor and walls" if box is None else "in the box before table, floor and walls"
        cure = "give a mask, or a box around the object; omad detect shows what was found"
        cure = cure if self.detector.known.gravity is None else f"check gravity, or {cure}"
        candidates = sorted((thing for thing in things if thing.evidence), key=_likelihood, reverse=True)
        if alone is not None and max(map(_likelihood, candidates), default=0.0) < max(SURE, as_one):
            return alone
        if not things:
            raise NothingSeen(f"no {names}: nothing stands {where}; {cure}")
        if not candidates:
            sizes = sorted(diagonal(thing.observation.points) for thing in things)
            count = len(things)
            what = f"{count} things of {sizes[0]:.2g} to {sizes[-1]:.2g} m stand {where}, none is about as large"
            if count == 1:
                what = f"the one thing that stands {where} is {sizes[0]:.2g} m large, which is not its size"
            usual = [usual_size(estimator.category) for estimator in self.detector.estimators]
            scale = wrong_scale(float(np.median(sizes)), float(np.median(usual))) if box is None else None
            told = f"{scale.why}: {scale.cure}" if scale else "check the depth scale"
            told = "what lies flat cannot be told from what it lies on" if box is not None else told
            raise NothingSeen(f"no {names}: {what}; {told}, or {cure}")
        best, likelihood = candidates[0], _likelihood(candidates[0])
        if likelihood < LIKELY and box is None:
            what = f"of {len(things)} things {where} the likeliest is one with {likelihood:.0%}"
            raise NothingSeen("; ".join([f"no {names}: {what}", *look.doubts, cure]))
        doubts = [*look.doubts]
        if likelihood < SURE:
            doubts.append(f"the thing taken for the {names} is one with {likelihood:.0%} only: look at it; {cure}")
        if others := [one for one in candidates[1:] if _likelihood(one) >= SURE]:
            places = ", ".join(_told(one, several) for one in others)
            taken = f"the likeliest, {called(best.likely)}," if several else "the likeliest"
            told = f"more than one {names} is seen: {taken} was taken, others are in the boxes {places}"
            doubts.append(f"{told}; omad detect gives them all, a box the one that is meant")
        return replace(best.observation.warned(*doubts), likelihood=likelihood)

    def _alone(self, frame: Observation, box: Sequence[float] | None) -> Observation | None:
        """What a frame shows, in the ``box``, where it has hardly any surroundings."""
        ratios = [size_ratio(frame.points, estimator.category) for estimator in self.detector.estimators]
        if measured_margin(frame) >= (TOUCHED if min(ratios) > ODD_SIZE else MEASURED):
            return None
        return frame if box is None else frame.part(frame.inside(box))

    def _likelihood_as_one(self, seen: Observation) -> float:
        """That all of what is seen is one object; 1 without a judgement where one thing holds most of it, or nothing
        stands before a plane."""
        things = things_before_planes(seen.points, LEAST).clusters
        if not things or len(things[0]) >= MOST * len(seen.points):
            return 1.0
        return _likelihood(self.detector.whole(seen))


def _told(thing: Detection, several: bool) -> str:
    """Where a thing is, of ``several`` categories what it is, and how likely."""
    what = f"{called(thing.likely)}, " if several else ""
    return f"{','.join(map(str, thing.box or ()))} ({what}{_likelihood(thing):.0%})"


def _likelihood(thing: Detection) -> float:
    """Of the likeliest category."""
    return max((share for name, share in thing.probabilities.items() if name is not None), default=0.0)
