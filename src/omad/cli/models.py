"""The commands that make object models and views of them: ``omad generate``, ``omad import``, ``omad render``."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from tyro.conf import OmitArgPrefixes

import omad
from omad.common.errors import InputError
from omad.common.files import check_folder
from omad.common.lazy import lazy_imports

from .answer import Answer
from .options import CategoryName, Cluster, DepthNoise, Json, Seed, Split, check_positive, check_workers, everywhere

with lazy_imports():
    from omad.applications.cluster.render import RenderWork
    from omad.data.artimage import write_artimage
    from omad.data.rendering import depth_noise as noises
    from omad.data.rendering.view_folder import render_to_folder
    from omad.data.shards.views import is_view_shards, run_record
    from omad.data.source import load_models
    from omad.data.urdf_import.importing import import_folder
    from omad.objects.category import Category
    from omad.objects.model import ObjectModel
    from omad.objects.urdf import write_urdf
    from omad.output.contact_sheet import contact_sheet
    from omad.output.picture import save

OF_ALL = "Of procedural objects, test: such that no training has seen; layout artimage: of all whose name is no number."


@dataclass(frozen=True, kw_only=True)
class Generate:
    """Write procedural objects as URDF."""

    category: CategoryName
    output: Path
    """Folder for a sub-folder an object, each with its URDF and meshes."""
    objects: int = 10
    """How many."""
    split: Split = "test"
    source: str = "procedural"
    """procedural, or a generator of your own (.py), which is run."""
    seed: Seed = 0
    json: Json = False

    def run(self) -> Answer:
        check_positive(objects=self.objects)
        check_folder(self.output)
        category, files = omad.get_category(self.category), []
        for model in load_models(self.source, category, self.objects, self.split, self.seed).models:
            files.append(str(self.output / model.name / f"{model.name}.urdf"))
            write_urdf(model, files[-1])
        folders = {path.name for path in self.output.iterdir() if path.is_dir()}
        if others := folders - {Path(file).parent.name for file in files}:
            said = f"holds {len(others)} others, {min(others)} say, that were not made now"
            print(f"{self.output}: {said}", file=sys.stderr)
        return Answer({"category": category.name, "files": files})


@dataclass(frozen=True, kw_only=True)
class Import:
    """Turn a folder of URDF or PartNet-Mobility models into canonical ones, which --source takes; resumes where it
    stopped. Prints what was refused and why, and draws the others for a look at how they stand."""

    source: tyro.conf.Positional[Path]
    """Folder of models: .urdf files, or a sub-folder for each."""
    category: CategoryName
    output: Path
    """Folder for a sub-folder an object, the summary and the picture."""
    scale: float | None = None
    """Metres per unit of the files; default: the category's for PartNet-Mobility, 1 for others."""
    missing_meshes: Literal["refuse", "skip"] = "refuse"
    """Of models whose mesh files are not all there: refuse the model, or use what is there."""
    mesh_folder: Path | None = None
    """Where meshes may lie besides each model's own folder (or ROS package); no others are opened."""
    json: Json = False

    def run(self) -> Answer:
        check_positive(scale=self.scale)
        if self.mesh_folder is not None and not self.mesh_folder.is_dir():
            raise InputError(f"--mesh-folder {self.mesh_folder}: no such folder")
        category = omad.get_category(self.category)
        found = import_folder(self.source, category, self.output, self.scale, self.missing_meshes, self.mesh_folder)
        if not found.models and len(found.refused) == 1:
            raise InputError(f"{self.source}: no usable model in it: {found.refused[0].reason}")
        for doubt in found.doubts:
            print(f"{self.source}: warning: {doubt.name} {doubt.reason}", file=sys.stderr)
        picture = self.output / "models.png"
        if found.models:
            save(contact_sheet(found.models), picture)
        record = {"folder": str(self.output), "category": category.name}
        record |= {"models": len(found.models) + len(found.refused), **found.to_dict()}
        record["picture"] = str(picture) if found.models else None
        return Answer(record, import_text, 0 if found.models else 2)


def import_text(answer: dict[str, Any]) -> str:
    """What became of a folder of models."""
    lines = [f"{answer['category']}: {len(answer['used'])} of {answer['models']} models -> {answer['folder']}"]
    lines += [f"{count} refused: {reason}" for reason, count in answer["reasons"].items() if count > 1]
    lines += [f"  {refusal['name']}: {refusal['reason']}" for refusal in answer["refused"]]
    lines += [f"note on {note['name']}: {note['reason']}" for note in answer["notes"]]
    lines += [f"see whether they stand alike: {answer['picture']}"] if answer["picture"] else []
    return "\n".join(lines)


@dataclass(frozen=True, kw_only=True)
class Render:
    """Render standard views (depth, part labels, truth) of object models into a folder, or cluttered scenes; resumes
    where it stopped."""

    category: CategoryName
    output: Path
    """Folder for the views; the same command goes on in it, one for more views adds to it, another is refused."""
    source: str = "procedural"
    """procedural, a generator of your own (.py), which is run, or a folder of URDF / PartNet-Mobility models."""
    objects: int = 20
    """Procedural objects."""
    split: Annotated[Split, tyro.conf.arg(help=OF_ALL)] = "test"
    layout: Literal["omad", "artimage"] = "omad"
    """artimage: as the ArtImage data set is laid out; another run adds another split or category to the same folder."""
    views: int = 200
    """In total, dealt out to the objects."""
    seed: Seed = 0
    depth_noise: DepthNoise = "off"
    clutter: bool = False
    """Scenes as cameras see them: surroundings, occluders, borders, several cameras and their noise, wrong masks, all
    at random. docs/robustness.md says what is written."""
    workers: int = 1
    """Processes that render at a time; 0: one a core. The views are the same for any number."""
    scale: OmitArgPrefixes[Cluster] = Cluster()
    json: Json = False

    def run(self) -> Answer:
        check_positive(objects=self.objects, views=self.views)
        check_folder(self.output)
        workers = check_workers(self.workers)
        if self.clutter and (self.depth_noise != "off" or self.layout != "omad"):
            raise InputError(
                "--clutter: has noise of its own, and no layout but omad; leave out --depth-noise and --layout"
            )
        category = omad.get_category(self.category)
        source = load_models(self.source, category, self.objects, self.split, self.seed)
        if self.scale.asked():
            return self._in_shards(category, source.models, workers)
        if is_view_shards(str(self.output)):
            raise InputError(f"{self.output}: is for views in shards; give --cluster, or another folder")
        noise, drawn = noises.LEVELS[self.depth_noise], (source.models, category, self.output, self.views)
        if self.layout == "artimage":
            write_artimage(*drawn, self.split, self.seed, noise, workers, progress=True)
        else:
            render_to_folder(*drawn, self.seed, noise, workers, progress=True, clutter=self.clutter)
        return Answer({"folder": str(self.output), "views": self.views, "refused": source.refused})

    def _in_shards(self, category: Category, models: Sequence[ObjectModel], workers: int) -> Answer:
        if self.layout != "omad":
            raise InputError(f"--layout {self.layout}: is of folders; leave it out, or --cluster")
        drawn = (
            everywhere(self.category),
            everywhere(self.source),
            self.objects,
            self.split,
            self.seed,
            self.depth_noise,
            self.clutter,
        )
        work = RenderWork(*drawn)
        made_of = {**asdict(work), **run_record(category, models), "version": omad.__version__}
        return Answer(self.scale.run(work, self.views, self.output, made_of, workers, "cpu").to_dict())
