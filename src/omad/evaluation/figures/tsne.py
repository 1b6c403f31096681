"""t-SNE of what a view says about which object it shows: predicted beta, the raw global feature, the Siamese net."""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import cycle
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.spatial import KDTree

from omad.common.batches import batched, progress
from omad.common.errors import InputError
from omad.data.source import ViewSource
from omad.estimation.estimator import Estimator
from omad.objects.category import Category

from ..baselines.siamese import SiameseEncoder, first_looks
from .style import FAINT, OBJECT_COLOURS, RULE, Sheet, styled

BATCH = 32
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


def collect(estimator: Estimator, siamese: SiameseEncoder | None, source: ViewSource) -> Signatures:
    """Describe every view of a source; views that show too little are left out."""
    net, objects = estimator.net, list[str]()
    found: dict[str, list[np.ndarray]] = defaultdict(list)
    shown = ((view.object, view.observed()) for view in progress(source.views, source.total))
    for some in batched(((name, seen) for name, seen in shown if seen is not None), BATCH):
        observations = [observation for _, observation in some]
        objects += [name for name, _ in some]
        found["beta"].append(np.stack([e.beta for e in estimator(observations)]))
        found["pooled"].append(first_looks(net, observations, lambda points: net.backbone(points).pooled))
        if siamese is not None:
            found["siamese"].append(siamese(observations))
    vectors = {kind: np.concatenate(rows) for kind, rows in found.items()}
    return Signatures(estimator.category, np.array(objects), vectors)


def embed(signatures: Signatures, seed: int = 0) -> dict[str, Map]:
    """Every kind of signature in the plane. Raises InputError for too few views, and without scikit-learn."""
    check_tsne()
    from sklearn.manifold import TSNE

    views = len(signatures.objects)
    if views < 5:
        raise InputError(f"{signatures.category.name}: {views} views are too few for t-SNE; give --views 5 or more")
    maps, perplexity = {}, min(PERPLEXITY, (views - 1) / 3)
    for kind, vectors in signatures.vectors.items():
        points = TSNE(perplexity=perplexity, init="pca", random_state=seed).fit_transform(vectors)
        nearest = np.asarray(KDTree(vectors).query(vectors, 2)[1])[:, 1]
        same = signatures.objects[nearest] == signatures.objects
        maps[kind] = Map(np.asarray(points, dtype=np.float64), float(same.mean()))
    return maps


def record(signatures: Signatures, maps: dict[str, Map]) -> dict[str, Any]:
    """The numbers behind a row of the figure."""
    drawn = {kind: {"points": m.points.tolist(), "nearest_is_same_object": m.same_object} for kind, m in maps.items()}
    objects = signatures.objects.tolist()
    return {"category": signatures.category.name, "views": len(objects), "objects": objects, "maps": drawn}


@styled
def draw(rows: Sequence[tuple[Signatures, dict[str, Map]]]) -> Figure:
    """A row a category, a column a kind of signature; one colour an object."""
    kinds = [kind for kind in TITLES if any(kind in maps for _, maps in rows)]
    sheet = Sheet.of(len(rows), len(kinds), 0.62 if len(kinds) > 2 else 0.5, bottom=0.3, gap=(0.14, 0.14))
    for column, kind in enumerate(kinds):
        sheet.header(column, TITLES[kind])
    for index, (signatures, maps) in enumerate(rows):
        sheet.label(index, signatures.category.name, ruled=False)
        for column, kind in enumerate(kinds):
            panel = sheet.panel(index, column)
            panel.set(xticks=[], yticks=[])
            panel.spines[:].set(visible=True, color=RULE)
            if kind in maps:
                _draw_map(panel, signatures, maps[kind])
    sheet.note("a point is a view, a colour an object · percent: views whose nearest neighbour is the same object")
    return sheet.figure


def _draw_map(panel: Axes, signatures: Signatures, found: Map) -> None:
    for name, colour in zip(sorted(set(signatures.objects.tolist())), cycle(OBJECT_COLOURS), strict=False):
        own = found.points[signatures.objects == name]
        panel.scatter(*own.T, s=6, color=colour, linewidths=0, alpha=0.9)
    panel.margins(0.05, 0.09)
    panel.text(
        0.985, 0.97, f"{found.same_object:.0%}", transform=panel.transAxes, ha="right", va="top", color=FAINT,
        fontsize=8.5, bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.0},
    )  # fmt: skip
