"""``omad eval pose``."""

from __future__ import annotations

import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from tyro.conf import OmitArgPrefixes

from omad.common.errors import InputError
from omad.common.files import make_folder
from omad.common.lazy import lazy_imports

from ..answer import Answer, table
from ..options import CategoryCommand, Cluster, Fast, ToSurface, Views, check_workers, everywhere
from .lines import refused, spread, states

with lazy_imports():
    from omad.evaluation.baselines import adam
    from omad.evaluation.evaluate import draw_worst, evaluate, failed, summary
    from omad.evaluation.evaluate_shards import PoseWork, from_rows
    from omad.evaluation.paper.predictions import weights_identity
    from omad.model.checkpoint import find_weights


@dataclass(frozen=True, kw_only=True)
class EvalPose(CategoryCommand):
    """Measure pose, joint states and joint axes on views of unseen objects, before and after refinement."""

    data: OmitArgPrefixes[Views] = Views()
    method: Literal["least_squares", "adam"] = "least_squares"
    """How to refine; adam: the paper's own recipe, for comparison."""
    fast: Fast = False
    to_surface: ToSurface = False
    pictures: Path | None = None
    """Folder for pictures of the worst views."""
    scale: OmitArgPrefixes[Cluster] = Cluster()
    output: Path | None = None
    """With --cluster: where the errors of all views are put."""
    workers: int = 0
    """With --cluster where there is no Ray: processes; 0: one a core."""

    def run(self) -> Answer:
        self.data.check()
        if self.scale.asked(output=self.output, workers=self.workers or None):
            return self._in_shards()
        estimator = self.estimator(self.fast, **({"refine": adam.adam_refinement} if self.method == "adam" else {}))
        if self.pictures is not None:
            make_folder(self.pictures)
        category = estimator.category
        source = self.data.load(category)
        results = evaluate(estimator, source.views, source.total, to_surface=self.to_surface)
        answer = summary([result.measured for result in results], category, self.data.source)
        answer |= {"depth_noise": source.noisy, "refused": source.refused, "failed": failed(results)}
        for reason, count in answer["failed"].items():
            print(f"{self.data.source}: {count} of {len(results)} views: {reason}", file=sys.stderr)
        if self.pictures is not None:
            answer["pictures"] = draw_worst(results, category, self.pictures)
        return Answer(answer, pose_text, 1 if answer["failures"] == len(results) else 0)

    def _in_shards(self) -> Answer:
        if self.output is None:
            raise InputError("--output: is missing; give a folder or an address for --cluster")
        if self.method != "least_squares" or self.pictures is not None:
            raise InputError("--method, --pictures: do not go with --cluster; leave them out")
        if self.data.broken == "skip":
            raise InputError("--broken skip: does not go with --cluster, whose shards count all images; leave one out")
        workers, category, data = check_workers(self.workers), self.estimator().category, self.data
        source = data.load(category)
        drawn = (everywhere(data.source), data.objects, data.views, data.seed, data.depth_noise, data.broken)
        weights = everywhere(self.weights) or self.category
        work = PoseWork(weights, self.device, self.fast, self.to_surface, *drawn)
        made_of = {**asdict(work), "weights": weights_identity(find_weights(weights)), **data.identity(source)}
        done = self.scale.run(work, source.total, self.output, made_of, workers, self.device)
        answer = summary([*from_rows(done.plan.rows())], category, data.source)
        answer |= {"depth_noise": source.noisy, "refused": source.refused, "run": done.to_dict()}
        return Answer(answer, pose_text, 1 if answer["failures"] == answer["views"] else 0)


def pose_text(answer: dict[str, Any]) -> str:
    """Errors before and after refinement, and of single objects; mean, median and 90th percentile."""
    shares = ("within_5deg_5percent", "flipped", "swapped")
    columns = ["joint state", "axis angle", "axis distance (units)", "base rotation", "within 5° 5 %", *shares[1:]]
    lines = {"initial": answer["initial"], "refined": answer["refined"]}
    if answer["objects"] <= 10:
        lines |= {f"  {entry['object']}": entry["refined"] for entry in answer["by_object"]}
    per_metre, rows = 1 / answer["metres_per_unit"], [["", *columns]]
    for label, errors in lines.items():
        distances = ["-" if error is None else spread(error, per_metre, "") for error in errors["axis_distance"]]
        axes = ", ".join(spread(error, 1, "°") for error in errors["axis_error_deg"])
        turned = spread(errors["rotation_error_deg"][0], 1, "°")
        cells = [label, states(errors, per_metre), axes, ", ".join(distances), turned]
        rows.append(cells + [f"{errors[share]:.1%}" for share in shares])
    seen = f"{answer['views']} views of {answer['objects']} objects"
    head = f"{answer['category']}, {answer['source']}: {seen}, mean / median / 90th percentile"
    seconds = {key: "-" if value is None else f"{1000 * value:.1f} ms" for key, value in answer["seconds"].items()}
    times = ", ".join(f"{key} {spent}" for key, spent in seconds.items())
    means = "95 % interval of means: not known from one object"
    if answer["objects"] > 1:
        found = answer["interval"]
        axes = ", ".join(spread(axis, 1, "°") for axis in found["axis_error_deg"])
        means = f"95 % interval of means, over objects: joint state {states(found, per_metre)}; axis angle {axes}"
    return "\n".join([head, table(rows), means, f"failures {answer['failures']}; per image: {times}", *refused(answer)])
