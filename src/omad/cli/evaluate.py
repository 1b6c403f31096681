"""``omad eval pose | shape | robustness | keypoints | views | retrieval``: how good weights are."""

from __future__ import annotations

import sys
from dataclasses import asdict, dataclass
from functools import partial
from itertools import chain
from math import isnan
from pathlib import Path
from typing import Any, Literal

from tyro.conf import OmitArgPrefixes

import omad
from omad.common.errors import InputError
from omad.common.files import make_folder
from omad.common.lazy import lazy_imports
from omad.common.user_cache import kept_at

from .answer import Answer, table
from .options import (
    BrokenFiles,
    CategoryCommand,
    Cluster,
    Device,
    Fast,
    Json,
    Models,
    ToSurface,
    Views,
    check_positive,
    check_workers,
    checkpoints,
    everywhere,
    load_prior,
    prior_of,
)

with lazy_imports():
    from numpy import ndarray

    from omad.common.runtime import pick_device
    from omad.data.source import ViewSource, load_views
    from omad.evaluation.baselines import adam
    from omad.evaluation.baselines.siamese import SiameseEncoder
    from omad.evaluation.evaluate import draw_worst, evaluate, failed, summary
    from omad.evaluation.evaluate_shards import PoseWork, from_rows
    from omad.evaluation.keypoint_spread import keypoint_spread
    from omad.evaluation.paper import published
    from omad.evaluation.paper.predictions import weights_identity
    from omad.evaluation.retrieval import experiment
    from omad.evaluation.retrieval.distances import methods
    from omad.evaluation.retrieval.pool import Pool, describe_with_omad, describe_with_siamese
    from omad.evaluation.retrieval.shards import described_in_shards
    from omad.evaluation.robustness import experiment as robustness
    from omad.evaluation.robustness import rows as robustness_rows
    from omad.evaluation.shape import evaluate_shapes, shape_summary
    from omad.evaluation.view_agreement import compare_views
    from omad.model.checkpoint import find_weights, is_checkpoint, load
    from omad.model.omadnet import OmadNet
    from omad.objects.category import Category


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
        if self.scale.cluster:
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
        distances = ["-" if error is None else _spread(error, per_metre, "") for error in errors["axis_distance"]]
        axes = ", ".join(_spread(error, 1, "°") for error in errors["axis_error_deg"])
        turned = _spread(errors["rotation_error_deg"][0], 1, "°")
        cells = [label, _states(errors, per_metre), axes, ", ".join(distances), turned]
        rows.append(cells + [f"{errors[share]:.1%}" for share in shares])
    seen = f"{answer['views']} views of {answer['objects']} objects"
    head = f"{answer['category']}, {answer['source']}: {seen}, mean / median / 90th percentile"
    seconds = {key: "-" if value is None else f"{1000 * value:.1f} ms" for key, value in answer["seconds"].items()}
    times = ", ".join(f"{key} {spent}" for key, spent in seconds.items())
    refused = [f"refused {each['name']}: {each['reason']}" for each in answer["refused"]]
    found, axes = answer["interval"], ", ".join(_spread(axis, 1, "°") for axis in answer["interval"]["axis_error_deg"])
    means = f"95 % interval of means, over objects: joint state {_states(found, per_metre)}; axis angle {axes}"
    return "\n".join([head, table(rows), means, f"failures {answer['failures']}; per image: {times}", *refused])


def _states(errors: dict[str, Any], per_metre: float) -> str:
    """Of every joint, in degrees or category units."""
    both = zip(errors["joint_state_error_deg"], errors["joint_state_error"], strict=True)
    return ", ".join(_spread(angle, 1, "°") if angle else _spread(length, per_metre, " u") for angle, length in both)


def _spread(error: dict[str, float] | tuple[float, float], factor: float, unit: str) -> str:
    values, digits = error.values() if isinstance(error, dict) else error, 1 if unit == "°" else 3
    return " / ".join(f"{factor * value:.{digits}f}{unit}" for value in values)


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
    refused = [f"refused {each['name']}: {each['reason']}" for each in answer["refused"]]
    return "\n".join([head, table(rows), f"failures {answer['failures']}", *refused])


@dataclass(frozen=True)
class SpoiltViews(Models):
    """The views to spoil."""

    source: str = "procedural"
    """procedural, a folder of URDF / PartNet-Mobility models, what ``omad render`` made, or a folder of the same
    layout with depth frames of your own; of images, rows that need another viewpoint or camera are left out."""
    objects: int = 60
    """Procedural objects a category: one a view, as views of one object err alike."""
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
        return Answer(answer, robustness_text)


def robustness_text(answer: dict[str, Any]) -> str:
    """A line a spoil: mean, median and 90th percentile of the joint states' errors, and shares."""
    errors, told = ["joint state", "ratio", "trusted"], ["in 50 %", "in 90 % interval", "flagged", "wrong"]
    columns = [*errors, *told, "silently wrong", "what"]
    lines = [["", *columns]]
    for row in answer["rows"]:
        angle, length = row["joint_state_error_deg"], row["joint_state_error"]
        states = [_spread(angle, 1, "°")] if angle else []
        states += [_spread(length, 1, " m")] if length else []
        keys = ("covered_50", "covered_90", "flagged", "wrong", "silently_wrong")
        shares = [f"{row[key]:.0%}" for key in keys]
        ratios = ["-" if ratio is None else f"{ratio:.2f}" for ratio in (row["ratio"], row["trusted"]["ratio"])]
        lines.append([row["row"], ", ".join(states), *ratios, *shares, row["what"]])
    head = f"{answer['category']}, {answer['source']}: {answer['views']} views a row, mean / median / 90th percentile"
    left_out = [f"left out, as there are no such views: {', '.join(answer['left_out'])}"] if answer["left_out"] else []
    refused = [f"refused {each['name']}: {each['reason']}" for each in answer["refused"]]
    others, told = answer["others"], answer["probability"]
    judged = [f"objects of other categories: {others['views']} views, {others['flagged']:.0%} flagged"]
    if told:
        area = "-" if isnan(told["area_under_roc"]) else f"{told['area_under_roc']:.3f}"
        error = f"calibration error {told['calibration_error']:.3f}, area under the ROC {area}"
        judged.append(f"probability of all {told['answers']} answers, {told['right']:.0%} of them right: {error}")
    return "\n".join([head, table(lines), *judged, *left_out, *refused])


@dataclass(frozen=True, kw_only=True)
class EvalKeypoints(CategoryCommand):
    """Show that keypoints correspond: how far each one's place in its part wanders between unseen objects."""

    weights: Path | None = None
    """Prior checkpoint folder in place of the shipped one."""
    data: OmitArgPrefixes[Models] = Models(objects=100)

    def run(self) -> Answer:
        check_positive(objects=self.data.objects)
        net = load_prior(self.weights or find_weights(self.category) / "prior", self.device)
        self.check_weights(net.category)
        return Answer(asdict(keypoint_spread(net, self.data.load(net.category).models)))


@dataclass(frozen=True, kw_only=True)
class EvalViews(CategoryCommand):
    """Show that training views are like rendered ones: the error of the network's first look on both."""

    data: OmitArgPrefixes[Models] = Models()
    views: int = 1000
    """Of each kind."""

    def run(self) -> Answer:
        check_positive(objects=self.data.objects, views=self.views)
        folder = find_weights(self.weights or self.category)
        net, priornet = load(OmadNet, folder).to(pick_device(self.device)), prior_of(folder, self.device)
        self.check_weights(net.category)
        models = self.data.load(net.category).models
        return Answer(asdict(compare_views(net, priornet, models, self.views, self.data.seed)))


@dataclass(frozen=True)
class ViewsOfEach(Views):
    """Views by the object, as retrieval counts them."""

    objects: int = 50
    """Procedural objects in all, from which galleries are drawn."""
    views: int = 100
    """Of each object; of a rendered folder or an ArtImage root always all."""

    @property
    def total(self) -> int:
        return self.objects * self.views


@dataclass(frozen=True, kw_only=True)
class EvalRetrieval:
    """The paper's Table 3: how well views of the same unseen object find each other, whatever pose and joint states.

    OMAD (refined and initial) against the Siamese network, beside the chance level; on galleries of as many objects as
    the paper's, on one of all objects ("large"), and with queries opened and galleries closed ("across_states")."""

    category: str | None = None
    """Only this one; default: every category with weights."""
    data: OmitArgPrefixes[ViewsOfEach] = ViewsOfEach()
    gallery: int | None = None
    """Objects in a gallery; default: the paper's number for the category."""
    draws: int = 20
    """Galleries that the scores are averaged over."""
    queries: int = 100
    """Of each gallery."""
    cache: Path | None = None
    """Folder of signatures; those of other weights, settings or data are refused. Default: in the user's cache."""
    weights: Path | None = None
    """Folder with a sub-folder a category in place of the shipped weights: <category>/ of OMADNet, and in it siamese/
    of the Siamese network. Without the latter that is left out."""
    device: Device = "cpu"
    json: Json = False

    def run(self) -> Answer:
        self.data.check()
        check_positive(gallery=self.gallery, draws=self.draws, queries=self.queries)
        names = () if self.category is None else (self.category,)
        return Answer(dict(self._category(folder) for folder in checkpoints(self.weights, names)), retrieval_text)

    def _category(self, folder: Path) -> tuple[str, dict[str, Any]]:
        """Its name, and the scores of every method."""
        estimator = omad.Estimator.from_pretrained(folder, self.device)
        category = estimator.category
        pool, embeddings = self._pool(estimator, folder)
        printed = published.TABLE3.get(category.name)
        count = self.gallery or (printed.objects if printed else published.USUAL_OBJECTS)
        settings = experiment.DrawSettings(self.draws, self.queries, self.data.seed)
        openness, everything = experiment.openness(pool.states, category), len(set(pool.objects.tolist()))
        galleries = [experiment.draw_galleries(pool.objects, size, settings) for size in (count, everything)]
        galleries.append(experiment.draw_across_states(pool.objects, openness, count, settings))
        answer = {}
        for name, method in methods(pool, embeddings, estimator.net.prior, category).items():
            usual, large, across = (experiment.evaluate_draws(draws, pool.objects, method) for draws in galleries)
            answer[name] = usual | {"large": large, "across_states": across, "paper": getattr(printed, name, None)}
        return category.name, answer

    def _pool(self, estimator: omad.Estimator, folder: Path) -> tuple[Pool, ndarray | None]:
        """From the cache as far as they are there; the rest is made, and put there."""
        data, category, siamese = self.data, estimator.category, folder / "siamese"
        cache = None if self.cache is None else self.cache / category.name
        source = data.load(category)
        total, identity = source.total, data.identity(source)
        made_of = identity | {"weights": weights_identity(folder), "settings": repr(estimator.config)}

        def described(name: str, made_of: dict[str, str], make: Any) -> dict[str, ndarray]:
            folder = kept_at(cache, "retrieval", name if cache else f"{category.name}-{name}", made_of)
            make_folder(folder)
            return described_in_shards(folder, made_of, total, lambda skip: data.load(category, skip).views, make)

        pool = Pool(**described("omad", made_of, partial(describe_with_omad, estimator)))
        if not is_checkpoint(siamese):
            print(
                f"{category.name}: no weights in {siamese}; pip install 'omad[baselines]', or omad train siamese",
                file=sys.stderr,
            )
            return pool, None
        encoder = SiameseEncoder.from_folder(siamese, self.device)
        made_of = identity | {"weights": weights_identity(siamese)}
        return pool, described("siamese", made_of, partial(describe_with_siamese, encoder))["embeddings"]


def retrieval_text(answer: dict[str, Any]) -> str:
    """The paper's Table 3, per cent; the chance level beside it."""
    rows = [["category", "method", "mAP@10", "NN", "1st tier", "2nd tier", "all objects", "across states", "paper"]]
    for category, methods in answer.items():
        first = methods["omad"]
        chance = first["chance"] | {key: first[key]["chance"] for key in ("large", "across_states")}
        for name, found in {**methods, "chance": chance}.items():
            shares = [found[key] for key in ("map_at_10", "nearest_neighbour", "first_tier", "second_tier")]
            shares += [found["large"]["map_at_10"], found["across_states"]["map_at_10"], found.get("paper")]
            rows.append([category, name, *("-" if share is None else f"{100 * share:.1f}" for share in shares)])
    return table(rows)
