"""How often ``--category auto`` finds the category of unseen objects, or that they are of none, and what that costs.

    OMP_NUM_THREADS=1 python benchmarks/accuracy/bench_auto_category.py [--models FOLDER] [--views 20] [--points 1000]
    OMP_NUM_THREADS=1 python benchmarks/accuracy/bench_auto_category.py --what look --picture docs/figures/proposals.png
    OMP_NUM_THREADS=1 python benchmarks/accuracy/bench_auto_category.py --what fit
    OMP_NUM_THREADS=1 python benchmarks/accuracy/bench_auto_category.py --what time

Views are standard ones with camera noise, of procedural test objects and of strangers that no training has seen, and of
the models in ``FOLDER/<category>/`` where one is given. ``look`` asks the network that proposes categories alone, about
all that it knows, with weights or without. ``fit`` works on other objects of the training split and prints the weights
for ``estimation/categories/ranking.py``, and, as categories are ranked now, for ``fronts.py``. ``time`` measures an
answer with 5, 10, ... and all of the categories.
"""

from __future__ import annotations

import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tyro
from matplotlib.figure import Figure
from scipy.optimize import minimize, minimize_scalar
from scipy.special import logsumexp
from tqdm import tqdm

from omad.data.procedural import generate
from omad.data.procedural.strangers import strangers
from omad.data.rendering.depth_noise import LEVELS
from omad.data.rendering.standard_views import standard_view
from omad.data.source import load_models
from omad.estimation.categories import ranking
from omad.estimation.categories.fronts import front_says
from omad.estimation.categories.late import LateEstimator, shipped_estimators
from omad.estimation.categories.proposals import Proposals
from omad.estimation.categories.ranking import against, rank
from omad.estimation.evidence import Evidence, measure_evidence
from omad.model.checkpoint import shipped_categories
from omad.model.fronts.network import shipped_front_net
from omad.model.proposals.network import shipped_proposer
from omad.objects.category_file import get_category
from omad.sensing.observation import Observation

OBJECTS = 10
"""Procedural ones a category; of a folder all are taken."""
STRANGERS = 5
"""So many times as many views show strangers as show one category, each another one."""
UNSEEN = {"train": 1, "test": 2}
"""Seeds of objects and strangers; the network that proposes has learned from those of seed 0."""
FIELDS = [*(field.name for field in fields(Evidence)), "in_front", "behind", "missing", "doubt"]
RIDGE = 1e-3
"""Keeps weights finite where the views are told apart without error."""
NONE = "none"
FIRST = 4
"""Likeliest categories, of a look, among which the true one may be."""
COUNTS = {NONE: 2.0, "others": 0.3}
"""How much strangers count in the fit, and objects of all categories that have no weights yet, beside one category."""
CHESTS = {"drawer", "drawer_1", "drawer_2", "drawer_4", "drawer_5"}
CLOSETS = {"cabinet_one_door", "cabinet_two_doors", "refrigerator", "refrigerator_two_doors"}
TWINS = CHESTS, CLOSETS
"""Categories that are near to each other, as they are the same but for a number, or where they are shut."""
MOST_OF_ALL = 20.0
"""In place of numbers that are none."""


@dataclass(frozen=True)
class Config:
    """What to measure."""

    what: Literal["answer", "look", "fit", "time"] = "answer"
    models: Path | None = None
    views: int = 20
    """A category and source."""
    noise: str = "on"
    points: int | None = None
    """Of each view that are left, at random; default: all, some ten thousand."""
    picture: Path | None = None
    """Where the confusion is drawn."""
    seed: int = 0


def views_of(config: Config, name: str, source: str = "procedural") -> list[Observation]:
    """Of one category's objects, every other one in a mirror where they may be of either hand; or of strangers."""
    split = "train" if config.what == "fit" else "test"
    count = config.views * (STRANGERS if name == NONE else 1)
    if name == NONE:
        others = strangers(count, UNSEEN[split] + 10 * config.seed)
        models = [(group.category, model) for group in others for model in group.models]
    else:
        category = get_category(name)
        own = [generate(category, index, split, UNSEEN[split]) for index in range(OBJECTS)]
        found = own if source == "procedural" else load_models(f"{source}/{name}", category, 0, split, 0).models
        models = [(category, model) for model in found]
    seen = []
    for index in range(count):
        category, model = models[index % len(models)]
        view = standard_view(model, category, (config.seed, 77, index), LEVELS[config.noise])
        observation = Observation.from_depth(view.depth, view.camera)
        if config.points is not None:
            order = np.random.default_rng((config.seed, index)).permutation(len(observation.points))
            observation = Observation.from_points(observation.points[order[: config.points]])
        seen.append(observation.mirrored() if category.either_hand and index % 2 else observation)
    return seen


@dataclass(frozen=True)
class Confusion:
    """What things are, and what they were taken for."""

    rows: list[str]
    columns: list[str]
    count: np.ndarray
    """(rows, columns)."""

    @classmethod
    def of(cls, pairs: Sequence[tuple[str, str]], order: Sequence[str]) -> Confusion:
        rows, columns = ([one for one in order if one in seen] for seen in map(set, zip(*pairs, strict=True)))
        columns = [one for one in order if one in {*rows, *columns}]
        count = np.zeros((len(rows), len(columns)), dtype=int)
        for truth, found in pairs:
            count[rows.index(truth), columns.index(found)] += 1
        return cls(rows, columns, count)

    def told(self) -> str:
        """Right shares, and what is mostly taken for what."""
        right = np.array([self.count[i, self.columns.index(name)] for i, name in enumerate(self.rows)])
        share = right / self.count.sum(1)
        own = [i for i, name in enumerate(self.rows) if name != NONE]
        lines = [f"right, categories: {right[own].sum()} of {self.count[own].sum()} ({share[own].mean():.1%})"]
        lines += [f"right, or a near twin: {np.mean([self._with_twins(i) for i in own]):.1%}"]
        for i, name in enumerate(self.rows):
            wrong = sorted(((n, c) for c, n in zip(self.columns, self.count[i], strict=True) if c != name and n))[::-1]
            lines.append(f"{name:24} {share[i]:6.1%}  " + ", ".join(f"{c} {n}" for n, c in wrong))
        return "\n".join(lines)

    def _with_twins(self, row: int) -> float:
        """Share of what a category is that was taken for it, or for one that is near to it."""
        name = self.rows[row]
        near = {name}.union(*(twins for twins in TWINS if name in twins))
        return sum(n for c, n in zip(self.columns, self.count[row], strict=True) if c in near) / self.count[row].sum()

    def draw(self, path: Path) -> None:
        """A picture: shares of each row."""
        figure = Figure(figsize=(0.38 * len(self.columns) + 2.6, 0.34 * len(self.rows) + 2.2), layout="constrained")
        panel = figure.subplots()
        share = self.count / self.count.sum(1, keepdims=True)
        panel.imshow(share, cmap="Blues", vmin=0, vmax=1)
        panel.set_xticks(range(len(self.columns)), self.columns, rotation=90)
        panel.set_yticks(range(len(self.rows)), self.rows)
        panel.set(xlabel="found", ylabel="true")
        for i, j in zip(*np.nonzero(share), strict=True):
            colour = "white" if share[i, j] > 0.5 else "black"
            panel.text(j, i, f"{100 * share[i, j]:.0f}", ha="center", va="center", fontsize=7, color=colour)
        figure.savefig(path, dpi=110)


def look(config: Config) -> None:
    """The network that proposes, alone."""
    propose = shipped_proposer()
    names = sorted(propose.net.names)
    pairs, first, few, number, seconds = [], [], [], [], []
    for name in tqdm([*names, NONE]):
        for observation in views_of(config, name):
            began = time.perf_counter()
            [found] = propose([observation])
            seconds.append(time.perf_counter() - began)
            pairs.append((name, next(iter(found)) or NONE))
            if name != NONE:
                worth = Proposals.of(found, names).worth_fitting(names)
                few.append(name in worth)
                number.append(len(worth))
                first.append(name in [one for one in found if one][:FIRST])
    confusion = Confusion.of(pairs, [*names, NONE])
    print(confusion.told())
    print(
        f"among the first {FIRST}: {np.mean(first):.1%}; among those to fit, {np.mean(number):.2f}: {np.mean(few):.1%}"
    )
    print(f"a look takes {1000 * np.median(seconds):.1f} ms, at best {1000 * min(seconds):.1f}")
    if config.picture is not None:
        confusion.draw(config.picture)


def answer(config: Config) -> None:
    """What ``--category auto`` says."""
    estimators = shipped_estimators()
    names = [estimator.category.name for estimator in estimators]
    for source in ("procedural", *([] if config.models is None else [str(config.models)])):
        known = [name for name in names if source == "procedural" or (Path(source) / name).is_dir()]
        pairs, fitted = [], []
        for name in tqdm([*known, NONE] if source == "procedural" else known):
            for observation in views_of(config, name, source):
                found = rank(observation, estimators)
                fitted.append(len(found.candidates))
                pairs.append((name, NONE if found.is_none else found.candidates[0].estimate.category.name))
        confusion = Confusion.of(pairs, [*names, NONE])
        print(f"{source}, {config.views} views a category, noise {config.noise}; {np.mean(fitted):.2f} fitted a view")
        print(confusion.told())
        if config.picture is not None and source == "procedural":
            confusion.draw(config.picture)


@dataclass(frozen=True)
class Example:
    """A view with what speaks against each of the categories that were fitted."""

    truth: str
    names: list[str]
    numbers: np.ndarray
    """(C, 9)."""
    scores: np.ndarray
    """(C,) of them, as they are ranked now."""
    fronts: np.ndarray
    """(C,) log-probability of each by the object's front; -inf where fronts tell nothing."""


def examples(config: Config, estimators: Sequence[LateEstimator]) -> list[Example]:
    """Of all that the look knows, with weights or without, and of strangers."""
    names, propose = [estimator.category.name for estimator in estimators], shipped_proposer()
    by_name = dict(zip(names, estimators, strict=True))
    found = []
    for truth in tqdm([*propose.net.names, NONE]):
        for observation in views_of(config, truth):
            [shares] = propose([observation])
            proposals = Proposals.of(shares, names)
            few, numbers, scores = proposals.worth_fitting(names), [], []
            estimates = [by_name[name](observation) for name in few]
            for name, estimate in zip(few, estimates, strict=True):
                evidence = measure_evidence(observation, estimate, by_name[name].net.prior)
                numbers.append([*against(observation, estimate, evidence), proposals.doubt(name)])
                scores.append(ranking.OFFSET - (np.array(numbers[-1]) - [*ranking.usual(name), 0.0]) @ as_it_is())
            fronts, net = np.full(len(few), -np.inf), shipped_front_net()
            known = [i for i, name in enumerate(few) if name in net.names and np.isfinite(scores[i])]
            if known:
                told = np.array(scores)[known]
                fronts[known] = front_says([estimates[i] for i in known], told, net)
            found.append(Example(truth, few, np.array(numbers).reshape(-1, len(FIELDS)), np.array(scores), fronts))
    return found


def fit(config: Config) -> None:
    """Weights (9,), none negative, and an offset, under which the true categories, or none, are likeliest."""
    tell_fit(examples(config, shipped_estimators()))


def tell_fit(found: Sequence[Example]) -> None:
    """The same, of views already looked at; writes what is usual."""
    own = shipped_categories()
    before = {name: ranking.usual(name) for name in own}
    right = {name: [e.numbers[e.names.index(name)] for e in found if e.truth == name in e.names] for name in own}
    after = {name: np.median(rows, 0)[:-1] for name, rows in right.items() if rows}
    ranking.USUAL.write_text(json.dumps({n: v.round(3).tolist() for n, v in after.items()}) + "\n", encoding="utf-8")
    weights, offset = fitted(found, above(found, after), own)
    print(f"LOG_ODDS = np.array([{', '.join(f'{value:.2g}' for value in weights[:-1])}])")
    print(f"PROPOSED = {weights[-1]:.2g}\nOFFSET = {offset:.2g}\nFRONT = {front(found):.2g}")
    answers = {"fitted": (after, weights, offset), "as it was": (before, as_it_is(), ranking.OFFSET)}
    for told, (levels, w, o) in answers.items():
        pairs = []
        for one, numbers in zip(found, above(found, levels), strict=True):
            which = int(np.append(o - numbers @ w, 0.0).argmax())
            pairs.append((one.truth if one.truth in own else NONE, [*one.names, NONE][which]))
        print(told, Confusion.of(pairs, [*own, NONE]).told())


def above(found: Sequence[Example], usual: Mapping[str, np.ndarray]) -> list[np.ndarray]:
    """(C, 9) of each view, what speaks against categories by how much it is more than usual."""
    mean = np.mean(list(usual.values()), axis=0)
    levels = [np.array([[*usual.get(name, mean), 0.0] for name in one.names]).reshape(-1, len(FIELDS)) for one in found]
    raised = [one.numbers - level for one, level in zip(found, levels, strict=True)]
    return [np.where(np.isfinite(numbers), numbers, MOST_OF_ALL) for numbers in raised]


def fitted(found: Sequence[Example], numbers: Sequence[np.ndarray], own: Sequence[str]) -> tuple[np.ndarray, float]:
    """Weights (9,) and the offset, of views and of what is ``above`` the usual in them."""
    spread, most = np.concatenate(numbers).std(0), max(map(len, numbers))
    kinds = [one.truth if one.truth in (*own, NONE) else "others" for one in found]
    share = np.array([COUNTS.get(kind, 1.0) / kinds.count(kind) for kind in kinds])
    right = np.array([one.names.index(one.truth) if one.truth in one.names else most for one in found])
    values = np.stack([np.pad(each / spread, ((0, most - len(each)), (0, 0))) for each in numbers])
    left_out = np.arange(most) >= np.array([[len(each)] for each in numbers])

    def loss(free: np.ndarray) -> float:
        scores = np.where(left_out, -np.inf, free[-1] - values @ free[:-1])
        scores = np.concatenate([scores, np.zeros((len(scores), 1))], 1)
        lost = logsumexp(scores, 1) - scores[np.arange(len(right)), right]
        return float(share @ lost / share.sum() + RIDGE * free[:-1] @ free[:-1])

    bounds = [(0, None)] * len(FIELDS) + [(None, None)]
    best = minimize(loss, np.ones(len(bounds)), bounds=bounds).x
    return best[:-1] / spread, float(best[-1])


def front(found: Sequence[Example]) -> float:
    """Weight of what fronts say under which the true ones are likeliest among those that these can be of."""
    told = []
    for one in found:
        known = np.isfinite(one.scores) & np.isfinite(one.fronts)
        if one.truth in one.names and known[true := one.names.index(one.truth)] and known.sum() > 1:
            told.append((one.scores[known], one.fronts[known], int(known[:true].sum())))

    def loss(weight: float) -> float:
        each = [(scores + weight * fronts, true) for scores, fronts, true in told]
        return float(np.mean([logsumexp(scores) - scores[true] for scores, true in each]))

    best: Any = minimize_scalar(loss, bounds=(0, 10), method="bounded")
    return float(best.x)


def as_it_is() -> np.ndarray:
    """(9,)."""
    return np.append(ranking.LOG_ODDS, ranking.PROPOSED)


def timed(config: Config) -> None:
    """An answer's time, by how many categories there are, with the look, and with all of them fitted."""
    every = shipped_estimators()
    seen = [view for name in shipped_categories() for view in views_of(config, name)]
    for view in seen:
        rank(view, every)
    for count in (*range(5, len(every), 5), len(every)):
        rng, seconds, fitted = np.random.default_rng(config.seed), [], []
        for view in seen:
            some = [every[i] for i in rng.permutation(len(every))[:count]]
            names = [one.category.name for one in some]
            for always in ((), names):
                began = time.perf_counter()
                fitted.append(len(rank(view, some, always=always).candidates))
                seconds.append(time.perf_counter() - began)
        few, all_of_them = 1000 * np.median(np.reshape(seconds, (-1, 2)), 0)
        told = f"{few:.0f} ms a view, {1000 * np.mean(seconds[::2]):.0f} in the mean, {np.mean(fitted[::2]):.2f} fitted"
        told += f"; all fitted {all_of_them:.0f} ms"
        print(f"{count} categories: {told}")


def main(config: Config) -> None:
    {"answer": answer, "look": look, "fit": fit, "time": timed}[config.what](config)


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
