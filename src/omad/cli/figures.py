"""The commands that draw figures."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tyro.conf import OmitArgPrefixes

from omad.common.errors import InputError
from omad.common.files import make_folder, write_json
from omad.common.lazy import lazy_imports

from .answer import Answer, known
from .options import (
    BrokenFiles,
    CategoriesCommand,
    Models,
    Seed,
    Views,
    check_positive,
    checkpoints,
    load_prior,
    prior_of,
)

with lazy_imports():
    from matplotlib.figure import Figure

    from omad.evaluation.baselines.ancsh.estimator import AncshEstimator
    from omad.evaluation.baselines.siamese import SiameseEncoder
    from omad.evaluation.evaluate import evaluate
    from omad.evaluation.figures import correspondence, occlusion, qualitative, style, sweep, tsne
    from omad.model.checkpoint import is_checkpoint


@dataclass(frozen=True, kw_only=True)
class _Drawing(CategoriesCommand):
    """What all commands of this file share."""

    output: Path = Path("omad-figures")
    """Folder for the pictures (PNG), and the numbers behind them (JSON)."""

    def _write(self, name: str, pictures: dict[str, Figure], numbers: list[Any], data: Models | Views) -> Answer:
        """Write ``pictures`` by their names, and the numbers, with six digits, as ``name``.json."""
        make_folder(self.output)
        files = [self.output / f"{stem}.png" for stem in pictures] + [self.output / f"{name}.json"]
        for figure, file in zip(pictures.values(), files, strict=False):
            style.save(figure, file)
        write_json(files[-1], {"source": data.source, "seed": data.seed, "categories": known(numbers, digits=6)})
        return Answer({"files": [str(file) for file in files]})


@dataclass(frozen=True, kw_only=True)
class FigureQualitative(_Drawing):
    """Unseen objects: depth image, parts, keypoints and joint axes before and after refinement, and the truth.

    A picture a category, and where there are several one with the first view of each. Views are the first ones, not
    chosen ones."""

    data: OmitArgPrefixes[Views] = Views(objects=2, views=4)

    def run(self) -> Answer:
        self.data.check()
        rows: dict[str, list[Any]] = {}
        pictures = {}
        for folder, estimator in self.estimators():
            category, prior = estimator.category, folder / "prior"
            priornet = load_prior(prior, self.device) if is_checkpoint(prior) else None
            seen = self.data.spread(category)
            results = evaluate(estimator, seen.views)
            found = [qualitative.shown(each, category, seen.model_of(each.view), priornet) for each in results]
            own = rows[category.name] = [row for row in found if row is not None]
            if not own:
                raise InputError(f"{self.data.source}: no view shows enough of a {category.name} to be estimated")
            pictures[f"qualitative-{category.name}"] = qualitative.draw(own, [row.result.view.object for row in own])
        if len(rows) > 1:
            pictures["qualitative"] = qualitative.draw([own[0] for own in rows.values()], list(rows))
        numbers = [qualitative.record(row) for own in rows.values() for row in own]
        return self._write("qualitative", pictures, numbers, self.data)


@dataclass(frozen=True, kw_only=True)
class FigureKeypoints(_Drawing):
    """The prior's keypoints on unseen complete objects, coloured by index, with the joint axes J(beta)."""

    data: OmitArgPrefixes[Models] = Models(objects=60)
    columns: int = 5
    """Objects that are drawn; all of them are drawn together at the right."""

    def run(self) -> Answer:
        check_positive(objects=self.data.objects, columns=self.columns)
        nets = [prior_of(folder, self.device) for folder in checkpoints(self.weights, self.categories)]
        rows = [correspondence.correspondence(net, self.data.load(net.category).models) for net in nets]
        picture = correspondence.draw(rows, min(self.columns, max(len(row.models) for row in rows)))
        return self._write("keypoints", {"keypoints": picture}, [*map(correspondence.record, rows)], self.data)


@dataclass(frozen=True, kw_only=True)
class FigureSweep(_Drawing):
    """One estimated object through its joints' travel, and the shapes that beta spans (plus and minus 2 sigma)."""

    source: str = "procedural"
    """procedural, a generator of your own (.py), a folder of URDF / PartNet-Mobility models, an ArtImage root (its test
    split), or a folder that ``omad render`` made."""
    seed: Seed = 0
    broken: BrokenFiles = "refuse"
    steps: int = 6
    """Joint states drawn, from one end of the travel to the other."""
    directions: int = 3
    """Of beta: those that move the keypoints most."""

    def run(self) -> Answer:
        check_positive(directions=self.directions)
        if self.steps < 2:
            raise InputError(f"--steps {self.steps}: must be at least 2, the two ends of the travel")
        data = Views(source=self.source, objects=1, views=1, seed=self.seed, broken=self.broken)
        joints, shapes = [], []
        for _, estimator in self.estimators():
            category, prior = estimator.category, estimator.net.prior
            if self.directions > (most := prior.basis_size):
                raise InputError(f"--directions {self.directions}: beta of a {category.name} has {most}; give no more")
            results = evaluate(estimator, data.spread(category).views)
            if not results or results[0].estimate is None:
                raise InputError(f"{self.source}: the first view shows too little of a {category.name}; try --seed")
            joints.append(sweep.joint_sweep(results[0].view, results[0].estimate, self.steps))
            shapes.append(sweep.shape_sweep(prior, category, self.directions, estimator.surfaces))
        pictures = {"sweep-joints": sweep.draw_joints(joints), "sweep-shapes": sweep.draw_shapes(shapes)}
        both = zip(joints, shapes, strict=True)
        numbers = [{"joints": sweep.record_joints(a), "shapes": sweep.record_shapes(b)} for a, b in both]
        return self._write("sweep", pictures, numbers, data)


@dataclass(frozen=True, kw_only=True)
class FigureOcclusion(_Drawing):
    """Error against occlusion: by what the view hides of the surface, and by pixels cut away on purpose.

    Of every view a random half-plane or box takes 0 to 60 % of the object's pixels. OMAD before and after refinement,
    and A-NCSH where the weights hold an ancsh/ folder."""

    data: OmitArgPrefixes[Views] = Views(objects=20, views=100)

    def run(self) -> Answer:
        self.data.check()
        rows = []
        for folder, estimator in self.estimators():
            methods: dict[str, Any] = {"omad": estimator}
            category, ancsh = estimator.category, folder / "ancsh"
            if is_checkpoint(ancsh):
                methods["ancsh"] = AncshEstimator.from_folder(ancsh, self.device)
            rows.append(occlusion.measure_occlusion(category, methods, self.data.spread(category), self.data.seed))
        return self._write("occlusion", {"occlusion": occlusion.draw(rows)}, [*map(occlusion.record, rows)], self.data)


@dataclass(frozen=True, kw_only=True)
class FigureTsne(_Drawing):
    """t-SNE of the beta predicted for unseen objects under many poses, beside the backbone's raw global feature, and
    the Siamese embedding where the weights hold a siamese/ folder. Needs omad[figures] (scikit-learn)."""

    data: OmitArgPrefixes[Views] = Views(objects=12, views=480)

    def run(self) -> Answer:
        self.data.check()
        tsne.check_tsne()
        rows = []
        for folder, estimator in self.estimators():
            siamese = folder / "siamese"
            encoder = SiameseEncoder.from_folder(siamese, self.device) if is_checkpoint(siamese) else None
            signatures = tsne.collect(estimator, encoder, self.data.spread(estimator.category))
            rows.append((signatures, tsne.embed(signatures, self.data.seed)))
        return self._write("tsne", {"tsne": tsne.draw(rows)}, [tsne.record(*row) for row in rows], self.data)
