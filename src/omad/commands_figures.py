"""The commands that draw figures."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from .ancsh.estimator import AncshEstimator
from .checkpoint import WEIGHTS, load_priornet
from .errors import InputError
from .estimator import Estimator
from .evaluation import evaluate
from .figures import correspondence, occlusion, qualitative, sweep, tsne
from .figures.seen import load_seen
from .figures.style import save
from .files import make_folder
from .options import BrokenFiles, Device, Json, Result, Seed, check_positive
from .priornet import PriorNet
from .retrieval.siamese_encoder import SiameseEncoder
from .runtime import pick_device
from .sources.select import load_models
from .view_folder import write_json


@dataclass(frozen=True)
class _Drawing:
    """What all commands of this file share."""

    categories: tuple[str, ...] = ()
    """Default: all with weights."""
    source: str = "procedural"
    """procedural, a folder of URDF / PartNet-Mobility models, an ArtImage root (its test split), or a folder that
    ``omad render`` made."""
    seed: Seed = 0
    output: Path = Path("omad-figures")
    """Folder for the pictures (PNG), and the numbers behind them (JSON)."""
    weights: Path | None = None
    """Folder with a sub-folder a category in place of the shipped weights, or the checkpoint of one category."""
    device: Device = "cpu"
    json: Json = False

    def _checkpoints(self) -> Iterator[Path]:
        """One a category. Raises InputError where there is none."""
        folder = self.weights or WEIGHTS
        if (folder / "config.json").is_file():
            yield folder
            return
        names = self.categories or tuple(sorted(path.parent.name for path in folder.glob("*/config.json")))
        if not names:
            raise InputError(f"{folder}: no <category>/config.json in it; give one with a checkpoint a category")
        for name in names:
            if not (folder / name / "config.json").is_file():
                raise InputError(
                    f"--categories {name}: no weights in {folder / name}; see omad info, or give --weights"
                )
            yield folder / name

    def _write(self, name: str, pictures: dict[str, Callable[[], Figure]], numbers: list[dict[str, Any]]) -> Result:
        """Draw and write ``pictures`` by their names, and the numbers as ``name``.json."""
        make_folder(self.output)
        files = []
        for stem, draw in pictures.items():
            files.append(self.output / f"{stem}.png")
            save(draw(), files[-1])
        files.append(self.output / f"{name}.json")
        write_json(files[-1], {"source": self.source, "seed": self.seed, "categories": _rounded(numbers)})
        return 0, {"files": [str(file) for file in files]}


@dataclass(frozen=True)
class FigureQualitative(_Drawing):
    """Unseen objects: depth image, parts, keypoints and joint axes before and after refinement, and the truth.

    A picture a category, and where there are several one with the first view of each. Views are the first ones, not
    chosen ones."""

    objects: int = 2
    """Procedural objects a category."""
    views: int = 4
    """A category, dealt out to the objects."""
    depth_noise: bool = False
    """Simulate the depth camera's noise."""
    broken: BrokenFiles = "refuse"

    def run(self) -> Result:
        check_positive(objects=self.objects, views=self.views)
        rows: dict[str, list[qualitative.Shown]] = {}
        for folder in self._checkpoints():
            estimator, priornet = Estimator.from_pretrained(folder, self.device), _priornet(folder, self.device)
            category = estimator.category
            views = load_seen(self.source, category, self.objects, self.views, self.seed, self.depth_noise, self.broken)
            seen = list(views.views)
            results = evaluate(estimator, [each.view for each in seen])
            found = [
                qualitative.shown(result, category, each.model, priornet)
                for result, each in zip(results, seen, strict=True)
            ]
            rows[category.name] = [row for row in found if row is not None]
            if not rows[category.name]:
                raise InputError(f"{self.source}: no view shows enough of a {category.name} to be estimated")
        pictures: dict[str, Callable[[], Figure]] = {}
        for name, own in rows.items():
            pictures[f"qualitative-{name}"] = lambda own=own: qualitative.draw(own, [r.result.view.object for r in own])
        if len(rows) > 1:
            first = [own[0] for own in rows.values()]
            pictures["qualitative"] = lambda: qualitative.draw(first, [row.category.name for row in first])
        return self._write("qualitative", pictures, [qualitative.record(row) for own in rows.values() for row in own])


@dataclass(frozen=True)
class FigureKeypoints(_Drawing):
    """The prior's keypoints on unseen complete objects, coloured by index, with the joint axes J(beta)."""

    objects: int = 60
    """Procedural objects a category."""
    columns: int = 5
    """Objects that are drawn; all of them are drawn together at the right."""

    def run(self) -> Result:
        check_positive(objects=self.objects, columns=self.columns)
        rows = []
        for folder in self._checkpoints():
            net = load_priornet(folder / "prior").to(pick_device(self.device))
            models = load_models(self.source, net.category, self.objects, "test", self.seed).models
            rows.append(correspondence.correspondence(net, models))
        columns = min(self.columns, max(len(row.models) for row in rows))
        pictures = {"keypoints": lambda: correspondence.draw(rows, columns)}
        return self._write("keypoints", pictures, [correspondence.record(row) for row in rows])


@dataclass(frozen=True)
class FigureSweep(_Drawing):
    """One estimated object through its joints' travel, and the shapes that beta spans (plus and minus 2 sigma)."""

    steps: int = 6
    """Joint states drawn, from one end of the travel to the other."""
    directions: int = 3
    """Of beta: those that move the keypoints most."""
    broken: BrokenFiles = "refuse"

    def run(self) -> Result:
        check_positive(directions=self.directions)
        if self.steps < 2:
            raise InputError(f"--steps {self.steps}: must be at least 2, the two ends of the travel")
        joints, shapes = [], []
        for folder in self._checkpoints():
            estimator = Estimator.from_pretrained(folder, self.device)
            category, prior = estimator.category, estimator.net.prior
            views = load_seen(self.source, category, 1, 1, self.seed, False, self.broken)
            result = evaluate(estimator, [each.view for each in views.views])[0]
            if result.estimate is None:
                raise InputError(f"{self.source}: the first view shows too little of a {category.name}; try --seed")
            joints.append(sweep.joint_sweep(result.view, result.estimate, self.steps))
            shapes.append(sweep.shape_sweep(prior, category, min(self.directions, prior.basis_size)))
        pictures = {
            "sweep-joints": lambda: sweep.draw_joints(joints),
            "sweep-shapes": lambda: sweep.draw_shapes(shapes),
        }
        numbers = [
            {"joints": sweep.record_joints(a), "shapes": sweep.record_shapes(b)}
            for a, b in zip(joints, shapes, strict=True)
        ]
        return self._write("sweep", pictures, numbers)


@dataclass(frozen=True)
class FigureOcclusion(_Drawing):
    """Error against occlusion: by what the view hides of the surface, and by pixels cut away on purpose.

    A random half-plane or box takes 0 to 60 % of the object's pixels. OMAD before and after refinement, and A-NCSH
    where the weights hold an ancsh/ folder."""

    objects: int = 20
    """Procedural objects a category."""
    views: int = 100
    """A category, each with every share cut away."""
    depth_noise: bool = False
    """Simulate the depth camera's noise."""
    broken: BrokenFiles = "refuse"

    def run(self) -> Result:
        check_positive(objects=self.objects, views=self.views)
        rows = []
        for folder in self._checkpoints():
            omad = Estimator.from_pretrained(folder, self.device)
            estimators: dict[str, Any] = {"omad": omad}
            if (folder / "ancsh" / "config.json").is_file():
                estimators["ancsh"] = AncshEstimator.from_folder(folder / "ancsh", self.device)
            category = omad.category
            views = load_seen(self.source, category, self.objects, self.views, self.seed, self.depth_noise, self.broken)
            rows.append(occlusion.measure_occlusion(category, estimators, views.views, views.total, self.seed))
        numbers = [occlusion.record(row) for row in rows]
        return self._write("occlusion", {"occlusion": lambda: occlusion.draw(rows)}, numbers)


@dataclass(frozen=True)
class FigureTsne(_Drawing):
    """t-SNE of the beta predicted for unseen objects under many poses, beside the backbone's raw global feature, and
    the Siamese embedding where the weights hold a siamese/ folder. Needs omad[figures] (scikit-learn)."""

    objects: int = 12
    """Procedural objects a category."""
    views: int = 480
    """A category, dealt out to the objects."""
    broken: BrokenFiles = "refuse"

    def run(self) -> Result:
        check_positive(objects=self.objects, views=self.views)
        tsne.check_tsne()
        rows = []
        for folder in self._checkpoints():
            estimator = Estimator.from_pretrained(folder, self.device)
            siamese = folder / "siamese"
            there = (siamese / "config.json").is_file()
            encoder = SiameseEncoder.from_folder(siamese, self.device) if there else None
            views = load_seen(self.source, estimator.category, self.objects, self.views, self.seed, False, self.broken)
            signatures = tsne.collect(estimator, encoder, views.views, views.total)
            rows.append((signatures, tsne.embed(signatures, self.seed)))
        numbers = [tsne.record(*row) for row in rows]
        return self._write("tsne", {"tsne": lambda: tsne.draw(rows)}, numbers)


def _rounded(value: Any) -> Any:
    """Numbers with six significant digits: files stay small, and no figure shows more. Unknown ones are null."""
    if isinstance(value, dict):
        return {key: _rounded(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_rounded(inner) for inner in value]
    if isinstance(value, float):
        return float(f"{value:.6g}") if math.isfinite(value) else None
    return value


def _priornet(folder: Path, device: str) -> PriorNet | None:
    """The one beside a network's weights, where there is one."""
    prior = folder / "prior"
    return load_priornet(prior).to(pick_device(device)) if (prior / "config.json").is_file() else None
