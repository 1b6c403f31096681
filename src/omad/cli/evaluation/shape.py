"""``omad eval shape``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from tyro.conf import OmitArgPrefixes

from omad.common.errors import InputError
from omad.common.lazy import lazy_imports

from ..answer import Answer, table
from ..options import CategoryCommand, Views
from .lines import refused

with lazy_imports():
    from omad.evaluation.shape import evaluate_shapes, shape_summary


@dataclass(frozen=True, kw_only=True)
class EvalShape(CategoryCommand):
    """Measure surfaces on views of unseen objects with meshes, beside hulls of keypoints: symmetric mean distance and
    F-score at 0.05 (category units), and the volumes' intersection over union where both are closed; where the object
    is seen, so that errors of pose and joint states count."""

    data: OmitArgPrefixes[Views] = Views(objects=100, views=100)

    def run(self) -> Answer:
        self.data.check()
        estimator = self.estimator()
        category, source = estimator.category, self.data.load(estimator.category)
        if not source.models:
            raise InputError(f"--source {self.data.source}: holds images, no meshes; give a folder of models")
        results = evaluate_shapes(estimator, source.views, source.models, source.total)
        answer = {"category": category.name, "source": self.data.source, "objects": len(source.models)}
        answer |= {"metres_per_unit": category.metres_per_unit, "refused": source.refused}
        answer |= shape_summary(results, [part.name for part in category.parts])
        return Answer(answer, shape_text, 1 if answer["failures"] == len(results) else 0)


def shape_text(answer: dict[str, Any]) -> str:
    """A line a part, surfaces beside hulls; mean and median."""
    measures, kinds = {"distance": 4, "f_score": 3, "iou": 3}, ("surface", "hull")
    heads = [f"{kind}: {name}" for name in ("distance (units)", "F at 0.05", "IoU") for kind in kinds]
    rows = [["", *heads]]
    for name in ("whole", *answer["surface"]["parts"]):
        cells = [name]
        for measure, digits in measures.items():
            for kind in kinds:
                found = answer[kind]["whole"] if name == "whole" else answer[kind]["parts"][name]
                spread = found.get(measure)
                cells.append(f"{spread['mean']:.{digits}f} / {spread['median']:.{digits}f}" if spread else "-")
        rows.append(cells)
    seen = f"{answer['views']} views of {answer['objects']} objects"
    head = f"{answer['category']}, {answer['source']}: {seen}, mean / median"
    return "\n".join([head, table(rows), f"failures {answer['failures']}", *refused(answer)])
