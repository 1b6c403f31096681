"""The commands that make the paper's tables."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

from . import __version__
from .ancsh.estimator import AncshEstimator
from .categories import Category
from .checkpoint import WEIGHTS
from .errors import InputError
from .estimator import Estimator
from .experiments.predictions import (
    Estimate,
    Predictions,
    Truths,
    data_identity,
    load_predictions,
    load_truths,
    predict,
    save_predictions,
    save_truths,
    weights_identity,
)
from .experiments.table1 import comparison, rows
from .files import make_folder
from .options import BrokenFiles, Device, Json, Result, Seed, check_positive
from .sources.select import load_views


@dataclass(frozen=True)
class EvalTable1:
    """The paper's Table 1: A-NCSH, OMAD initial and OMAD refined on the same views, beside the paper's own figures.

    Predictions are kept in --cache, and the table is made from them; the same command again takes seconds."""

    categories: tuple[str, ...] = ()
    """Default: all with weights."""
    source: str = "procedural"
    """procedural, or a folder as ``omad eval pose`` takes it (an ArtImage root, say)."""
    objects: int = 20
    """Procedural objects a category."""
    views: int = 200
    """A category, in total; of a rendered folder or an ArtImage root always all."""
    seed: Seed = 0
    depth_noise: bool = False
    """Simulate the depth camera's noise."""
    broken: BrokenFiles = "refuse"
    cache: Path = Path("omad-predictions")
    """Folder of predictions. Those of other weights, settings or data are refused."""
    weights: Path | None = None
    """Folder with a sub-folder a category in place of the shipped weights: <category>/ of OMADNet, and in it ancsh/ of
    A-NCSH. Without the latter A-NCSH is left out."""
    device: Device = "cpu"
    json: Json = False

    def run(self) -> Result:
        check_positive(objects=self.objects, views=self.views)
        folder = self.weights or WEIGHTS
        names = self.categories or tuple(sorted(path.parent.name for path in folder.glob("*/config.json")))
        if not names:
            raise InputError(f"{folder}: no <category>/config.json in it; give a folder with one checkpoint a category")
        lines: list[dict[str, Any]] = []
        compared, left_out = {}, []
        for name in names:
            estimator = Estimator.from_pretrained(folder / name, self.device)
            truths, said = self._predictions(estimator, folder / name)
            own = rows(truths, said, estimator.category)
            lines += own
            compared[name] = comparison(own)
            if "ancsh" not in said:
                reason = f"no weights in {folder / name / 'ancsh'}; omad train ancsh makes them"
                left_out.append({"category": name, "method": "ancsh", "reason": reason})
        return 0, {
            "table": "1",
            "source": self.source,
            "depth_noise": self.depth_noise,
            "seed": self.seed,
            "rows": lines,
            "comparison": compared,
            "left_out": left_out,
        }

    def _predictions(self, omad: Estimator, folder: Path) -> tuple[Truths, dict[str, Predictions]]:
        """From the cache as far as they are there; the rest is made, and put there."""
        category = omad.category
        estimators: dict[str, Estimate] = {"omad": omad}
        made_of = {"omad": {"weights": weights_identity(folder), "settings": repr(omad.config)}}
        if (folder / "ancsh" / "config.json").is_file():
            ancsh = AncshEstimator.from_folder(folder / "ancsh", self.device)
            estimators["ancsh"] = lambda observation: ancsh([observation])[0]
            made_of["ancsh"] = {"weights": weights_identity(folder / "ancsh"), "settings": repr(ancsh.config)}
        data = {"data": self._data(category), "version": __version__}
        cache = self.cache / category.name
        make_folder(cache)

        truths = load_truths(cache / "truth.npz", data)
        kept = {name: load_predictions(cache / f"{name}.npz", data | made_of[name]) for name in estimators}
        said = {name: found for name, found in kept.items() if found is not None}
        missing = {name: estimator for name, estimator in estimators.items() if name not in said}
        if truths is None or missing:
            source = self._load(category)
            truths, new = predict(source.views, source.total, category, missing)
            save_truths(cache / "truth.npz", truths, data)
            for name, found in new.items():
                save_predictions(cache / f"{name}.npz", found, data | made_of[name])
            said |= new
        return truths, said

    def _load(self, category: Category):
        return load_views(self.source, category, self.objects, self.views, self.seed, self.depth_noise, self.broken)

    def _data(self, category: Category) -> str:
        settings = {"objects": self.objects, "views": self.views, "seed": self.seed, "noise": self.depth_noise}
        return data_identity(list(islice(self._load(category).views, 3)), self.source, settings)
