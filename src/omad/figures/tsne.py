"""t-SNE of what a view says about which object it shows: predicted beta, the raw global feature, the Siamese net."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.spatial import KDTree
from tqdm import tqdm

from ..categories import Category
from ..errors import InputError
from ..estimator import Estimator
from ..observation import Observation
from ..omadnet import OmadNet, first_frame, to_input_frame
from ..retrieval.siamese_encoder import SiameseEncoder
from ..views import sample_clouds
from .seen import Seen
from .style import FAINT, RULE, Sheet, object_colours, styled

BATCH = 32
SAMPLES = 4
"""Random choices of a cloud's points that the raw feature is averaged over, as many as the estimator looks at."""
PERPLEXITY = 30.0
TITLES = {"beta": "predicted beta", "pooled": "raw global feature", "siamese": "Siamese embedding"}


@dataclass(frozen=True)
class Signatures:
    """What V views are known by, of one category."""

    category: Category
    objects: np.ndarray
    """(V,) names."""
    vectors: dict[str, np.ndarray]
    """Per kind (V, any)."""


@dataclass(frozen=True)
class Map:
    """One kind of signature in the plane."""

    points: np.ndarray
    """(V, 2)."""
    same_object: float
    """Share of views whose nearest neighbour, in the space of the signature, shows the same object."""


def check_tsne() -> None:
    """Raises InputError where scikit-learn is not installed; it is only needed here."""
    try:
        import sklearn.manifold  # noqa: F401
    except ImportError as error:
        raise InputError("t-SNE needs scikit-learn, which is not installed; pip install 'omad[figures]'") from error


def collect(estimator: Estimator, siamese: SiameseEncoder | None, views: Iterable[Seen], total: int) -> Signatures:
    """Describe every view; views that show too little are left out."""
    objects: list[str] = []
    found: dict[str, list[np.ndarray]] = {}
    pending: list[tuple[str, Observation]] = []

    def describe() -> None:
        observations = [observation for _, observation in pending]
        objects.extend(name for name, _ in pending)
        pending.clear()
        found.setdefault("beta", []).append(np.stack([e.beta for e in estimator(observations)]))
        found.setdefault("pooled", []).append(_pooled(estimator.net, observations, estimator.device))
        if siamese is not None:
            found.setdefault("siamese", []).append(siamese(observations))

    for seen in tqdm(views, total=total, unit="view", file=sys.stderr, disable=not sys.stderr.isatty()):
        try:
            pending.append((seen.view.object, Observation.from_depth(seen.view.depth, seen.view.camera)))
        except InputError:  # too little of the object is left to be seen
            continue
        if len(pending) == BATCH:
            describe()
    if pending:
        describe()
    vectors = {kind: np.concatenate(rows) for kind, rows in found.items()}
    return Signatures(estimator.category, np.array(objects), vectors)


@torch.no_grad()
def _pooled(net: OmadNet, observations: Sequence[Observation], device: torch.device) -> np.ndarray:
    """(B, width) global feature of the backbone at its first look, in camera axes."""
    clouds, _ = sample_clouds(observations, net.backbone.config.points, SAMPLES, 0, net.category, device)
    points = clouds.flatten(0, 1)
    pooled = net.backbone(to_input_frame(points, first_frame(points))).pooled
    return pooled.unflatten(0, (len(observations), -1)).mean(1).cpu().double().numpy()


def embed(signatures: Signatures, seed: int = 0) -> dict[str, Map]:
    """Every kind of signature in the plane. Raises InputError for too few views, and without scikit-learn."""
    check_tsne()
    from sklearn.manifold import TSNE

    views = len(signatures.objects)
    if views < 5:
        raise InputError(f"{signatures.category.name}: {views} views are too few for t-SNE; give --views 5 or more")
    maps = {}
    for kind, vectors in signatures.vectors.items():
        perplexity = min(PERPLEXITY, (views - 1) / 3)
        points = TSNE(perplexity=perplexity, init="pca", random_state=seed).fit_transform(vectors)
        nearest = np.asarray(KDTree(vectors).query(vectors, 2)[1])[:, 1]
        same = signatures.objects[nearest] == signatures.objects
        maps[kind] = Map(np.asarray(points, dtype=np.float64), float(same.mean()))
    return maps


def record(signatures: Signatures, maps: dict[str, Map]) -> dict[str, Any]:
    """The numbers behind a row of the figure."""
    return {
        "category": signatures.category.name,
        "views": len(signatures.objects),
        "objects": signatures.objects.tolist(),
        "maps": {
            kind: {"points": found.points.tolist(), "nearest_is_same_object": found.same_object}
            for kind, found in maps.items()
        },
    }


def draw(rows: Sequence[tuple[Signatures, dict[str, Map]]]) -> Figure:
    """A row a category, a column a kind of signature; one colour an object."""
    kinds = [kind for kind in TITLES if any(kind in maps for _, maps in rows)]
    with styled():
        sheet = Sheet.of(len(rows), len(kinds), 0.62 if len(kinds) > 2 else 0.5, bottom=0.3, gap=(0.14, 0.14))
        for column, kind in enumerate(kinds):
            sheet.header(column, TITLES[kind])
        for index, (signatures, maps) in enumerate(rows):
            sheet.label(index, signatures.category.name)
            for column, kind in enumerate(kinds):
                panel = sheet.panel(index, column)
                panel.set_xticks([])
                panel.set_yticks([])
                for side in panel.spines.values():
                    side.set(visible=True, color=RULE)
                if kind in maps:
                    _draw_map(panel, signatures, maps[kind])
        sheet.note("a point is a view, a colour an object · percent: views whose nearest neighbour is the same object")
        return sheet.figure


def _draw_map(panel: Axes, signatures: Signatures, found: Map) -> None:
    names = sorted(set(signatures.objects.tolist()))
    for name, colour in zip(names, object_colours(len(names)), strict=True):
        own = found.points[signatures.objects == name]
        panel.scatter(*own.T, s=6, color=colour, linewidths=0, alpha=0.9)
    panel.margins(0.05, 0.09)
    panel.text(
        0.985, 0.97, f"{found.same_object:.0%}", transform=panel.transAxes, ha="right", va="top", color=FAINT,
        fontsize=8.5, bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.0},
    )  # fmt: skip
