"""The paper's Table 3: galleries of unseen objects' views, drawn again and again from a pool, and how well views of
the same object are found in them."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from omad.objects.category import Category

from .distances import TOGETHER, Ranker
from .metrics import Scores, chance, mean_scores, rank, scores


@dataclass(frozen=True)
class Draw:
    """One gallery and the queries put to it: rows of a pool."""

    gallery: np.ndarray
    """(G,)."""
    queries: np.ndarray
    """(Q, TOGETHER): a view, and other views of the same object for the methods that take several. Those that a method
    takes are no answers to it."""


@dataclass(frozen=True)
class DrawSettings:
    """How galleries are drawn."""

    draws: int = 20
    queries: int = 100
    seed: int = 0


def draw_galleries(objects: np.ndarray, count: int, settings: DrawSettings) -> list[Draw]:
    """All views of ``count`` random objects of a pool (names (V,)), and random views among them as queries."""
    rng = np.random.default_rng([settings.seed, count])
    names = np.unique(objects)
    found = []
    for _ in range(settings.draws):
        gallery = np.nonzero(np.isin(objects, rng.choice(names, min(count, len(names)), replace=False)))[0]
        queries = rng.choice(gallery, min(settings.queries, len(gallery)), replace=False)
        found.append(Draw(gallery, _with_others(queries, gallery, objects, rng)))
    return found


def draw_across_states(objects: np.ndarray, opened: np.ndarray, count: int, settings: DrawSettings) -> list[Draw]:
    """Galleries of the third of each object's views whose joints are least ``opened`` (V,), queries from the third
    whose joints are most: a signature that saw the pose would fail."""
    rng = np.random.default_rng([settings.seed, count, 1])
    thirds = []
    for name in np.unique(objects):
        own = np.nonzero(objects == name)[0]
        own = own[np.argsort(opened[own], kind="stable")]
        third = max(len(own) // 3, 1)
        thirds.append((own[:third], own[-third:]))
    found = []
    for _ in range(settings.draws):
        chosen = rng.choice(len(thirds), min(count, len(thirds)), replace=False)
        gallery, asked = (np.concatenate(views) for views in zip(*(thirds[i] for i in chosen), strict=True))
        queries = rng.choice(asked, min(settings.queries, len(asked)), replace=False)
        found.append(Draw(gallery, _with_others(queries, asked, objects, rng)))
    return found


def _with_others(queries: np.ndarray, among: np.ndarray, objects: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(Q, TOGETHER): queries (Q,), each with random other views of its object, or itself again where there are none."""
    rows = []
    for query in queries:
        others = among[(objects[among] == objects[query]) & (among != query)]
        taken = rng.permutation(others)[: TOGETHER - 1]
        rows.append([query, *taken, *[query] * (TOGETHER - 1 - len(taken))])
    return np.array(rows)


def openness(states: np.ndarray, category: Category) -> np.ndarray:
    """(V,) mean over the joints of how far each is on its way from rest to its farther limit."""
    limits = category.metric_limits
    far = np.take_along_axis(limits, np.abs(limits).argmax(1)[:, None], 1)[:, 0]
    return (states / far).mean(1)


def evaluate_draws(draws: list[Draw], objects: np.ndarray, method: Ranker) -> dict[str, Any]:
    """Scores averaged over draws, how mAP@10 varies between them, and the chance level on the same galleries; of
    queries to which the gallery has an answer, NaN where it has none to any."""
    rng, found, random = np.random.default_rng(0), list[Scores](), list[Scores]()
    for draw in draws:
        queries = draw.queries[:, : method.views]
        left_out = (queries[:, :, None] == draw.gallery).any(1)
        distances = method.distance(queries, draw.gallery)
        order = rank(distances, left_out)
        same = (objects[draw.gallery] == objects[queries[:, :1]]) & ~left_out
        relevant = np.take_along_axis(same, order, 1)
        relevant[~np.isfinite(distances).any(1)] = False  # who says nothing has found nothing
        if (answerable := same.any(1)).any():
            found.append(scores(relevant[answerable]))
            random.append(chance(relevant[answerable], rng, permutations=1))
    return {
        **asdict(mean_scores(found)),
        "map_at_10_std": float(np.std([one.map_at_10 for one in found])) if found else np.nan,
        "chance": asdict(mean_scores(random)),
        "objects": int(np.mean([len(np.unique(objects[draw.gallery])) for draw in draws])),
        "gallery": int(np.mean([len(draw.gallery) for draw in draws])),
        "draws": len(draws),
    }
