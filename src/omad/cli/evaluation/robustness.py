"""``omad eval robustness``."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain
from math import isnan
from pathlib import Path
from typing import Any

from tyro.conf import OmitArgPrefixes

from omad.common.errors import InputError
from omad.common.files import make_folder
from omad.common.lazy import lazy_imports

from ..answer import Answer, table
from ..options import BrokenFiles, CategoryCommand, Models, ToSurface, check_positive
from .lines import refused, spread

with lazy_imports():
    from omad.data.source import ViewSource, load_views
    from omad.evaluation.robustness import experiment as robustness
    from omad.evaluation.robustness import rows as robustness_rows
    from omad.objects.category import Category


@dataclass(frozen=True)
class SpoiltViews(Models):
    """The views to spoil."""

    source: str = "procedural"
    """procedural, a generator of your own (.py), a folder of URDF / PartNet-Mobility models, what ``omad render`` made,
    or a folder of the same layout with depth frames of your own; of images, rows that need another viewpoint or camera
    are left out."""
    objects: int = 200
    """Procedural objects a category, at most as many as views: those of one object err alike."""
    views: int = 60
    """Of each row, dealt out to the objects; of images, evenly over all of them."""
    broken: BrokenFiles = "refuse"

    def views_of(self, category: Category) -> ViewSource:
        return load_views(self.source, category, self.objects, self.views, self.seed, "off", self.broken)


@dataclass(frozen=True, kw_only=True)
class EvalRobustness(CategoryCommand):
    """Measure joint states on views spoilt in every way, one way at a time and all at once: surroundings, wrong masks,
    occluders, borders, noise of several cameras, viewpoints. docs/robustness.md says how large each spoil is."""

    data: OmitArgPrefixes[SpoiltViews] = SpoiltViews()
    rows: tuple[str, ...] = ()
    """Names of rows; default: all. The clean one is always there."""
    to_surface: ToSurface = False
    pictures: Path | None = None
    """Folder for a picture of each row's worst view."""

    def run(self) -> Answer:
        check_positive(objects=self.data.objects, views=self.data.views)
        known = robustness_rows.ROWS
        if unknown := set(self.rows) - known.keys():
            raise InputError(f"--rows {' '.join(sorted(unknown))}: no such row; there are {', '.join(known)}")
        rows = {name: row for name, row in known.items() if name in (robustness_rows.CLEAN, *(self.rows or known))}
        estimator = self.estimator()
        if self.pictures is not None:
            make_folder(self.pictures)
        category = estimator.category
        source = self.data.views_of(category)
        source = source if source.models else source.spread(self.data.views)
        rows |= {} if source.models else {robustness_rows.CLEAN: robustness_rows.AS_THEY_ARE}
        scenes = robustness.scenes_from(source, category, self.data.seed)
        found = robustness.measure(estimator, scenes, source.total, rows, self.to_surface)
        answer = {"category": category.name, "source": self.data.source, "seed": self.data.seed}
        answer |= {"views": source.total, "rows": robustness.table(found, rows, category)}
        others = robustness.others(estimator, self.data.views, self.data.seed)
        answer["others"] = {"views": len(others), "flagged": sum(each.flagged for each in others) / max(len(others), 1)}
        answer["probability"] = robustness.judged([*chain(*found.values()), *others])
        answer |= {"left_out": [name for name, measured in found.items() if not measured], "refused": source.refused}
        if self.pictures is not None:
            answer["pictures"] = robustness.draw_worst(estimator, scenes, found, rows, self.pictures, self.to_surface)
        return Answer(answer, robustness_text, int(all(row["missing"] == row["views"] for row in answer["rows"])))


def robustness_text(answer: dict[str, Any]) -> str:
    """A line a spoil: mean, median and 90th percentile of the joint states' errors, and shares."""
    errors, told = ["joint state", "ratio", "trusted", "seen"], ["in 50 %", "in 90 % interval", "flagged", "wrong"]
    columns = [*errors, *told, "silently wrong", "what"]
    lines = [["", *columns]]
    for row in answer["rows"]:
        angle, length = row["joint_state_error_deg"], row["joint_state_error"]
        states = [spread(angle, 1, "°")] if angle else []
        states += [spread(length, 1, " m")] if length else []
        keys = ("covered_50", "covered_90", "flagged", "wrong", "silently_wrong")
        shares = [f"{row[key]:.0%}" for key in keys]
        ratios = [of["ratio"] for of in (row, row["trusted"], row["seen"])]
        told_ratios = ["-" if ratio is None else f"{ratio:.2f}" for ratio in ratios]
        lines.append([row["row"], ", ".join(states), *told_ratios, *shares, row["what"]])
    head = f"{answer['category']}, {answer['source']}: {answer['views']} views a row, mean / median / 90th percentile"
    left_out = [f"left out, as there are no such views: {', '.join(answer['left_out'])}"] if answer["left_out"] else []
    others, told = answer["others"], answer["probability"]
    judged = [f"objects of other categories: {others['views']} views, {others['flagged']:.0%} flagged"]
    if told:
        area = "-" if isnan(told["area_under_roc"]) else f"{told['area_under_roc']:.3f}"
        error = f"calibration error {told['calibration_error']:.3f}, area under the ROC {area}"
        judged.append(f"probability of all {told['answers']} answers, {told['right']:.0%} of them right: {error}")
    return "\n".join([head, table(lines), *judged, *left_out, *refused(answer)])
