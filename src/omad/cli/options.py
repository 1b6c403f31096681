"""Options that many commands share."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from itertools import islice
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

import omad
from omad.common.errors import InputError, shown
from omad.common.lazy import lazy_imports
from omad.common.limits import check_limit
from omad.common.stderr import tell
from omad.objects.builtin import builtin_names

with lazy_imports():
    from torch import set_num_threads

    from omad.applications.cluster.engines import choose_engine
    from omad.applications.cluster.shards import Plan, Sharded, Work, run_shards
    from omad.applications.retrieval.signature import prior_fingerprint
    from omad.common.incoming import is_path
    from omad.common.runtime import cores, keep_freed_memory, pick_device
    from omad.data import procedural
    from omad.data.shards.store import Store
    from omad.data.source import ModelSource, ViewSource, load_models, load_views
    from omad.evaluation.paper.predictions import data_identity
    from omad.model import checkpoint
    from omad.model.omadnet import OmadNet
    from omad.model.prior import OmadPrior
    from omad.model.priornet import PriorNet
    from omad.objects.category import Category
    from omad.objects.category_file import is_spec_file, read_spec
    from omad.objects.model import digest_of_models

ALIASES = {"categories": "--category"}
"""Other names of options, by field."""
MOST_THREADS = 1024
LARGEST = 1e9
"""Of numbers on the command line."""
BUILT_IN = ", ".join(builtin_names())
"""Categories by name."""
OWN = "or your own: a spec file (.toml, .json), or the name in --weights."
CategoryName = Annotated[str, tyro.conf.arg(help=f"{BUILT_IN}; {OWN}")]
Seed = Annotated[int, tyro.conf.arg(help="Another seed, other random choices.")]
Json = Annotated[bool, tyro.conf.arg(help="Print one JSON object on stdout and nothing else there.")]
Device = Annotated[str, tyro.conf.arg(help="cpu, cuda, or auto: CUDA where there is one.")]
Weights = Annotated[
    Path | None, tyro.conf.arg(help="Checkpoint folder, or its address, in place of the shipped weights.")
]
Fast = Annotated[bool, tyro.conf.arg(help="Look half as often: nearly twice as fast, a little less accurate.")]
_TO_SURFACE = "Go on towards the fit to the surface, as far as that helped on unseen objects; takes 0.25 to 0.4 s more."
ToSurface = Annotated[bool, tyro.conf.arg(help=_TO_SURFACE)]
Split = Annotated[Literal["train", "test"], tyro.conf.arg(help="test: objects that no training has seen.")]
_NOISE = "How much of a stereo camera's noise is simulated; folders of images have their own."
DepthNoise = Annotated[Literal["off", "half", "on", "double"], tyro.conf.arg(help=_NOISE)]
_BROKEN = "Broken files of an ArtImage root or a rendered folder: refuse it, or skip what they belong to and list it."
BrokenFiles = Annotated[Literal["refuse", "skip"], tyro.conf.arg(help=_BROKEN)]


@dataclass(frozen=True, kw_only=True)
class CategoryCommand:
    """A command that works with the weights of one category."""

    category: CategoryName
    weights: Weights = None
    device: Device = "cpu"
    json: Json = False

    def estimator(self, fast: bool = False, **settings: Any) -> omad.Estimator:
        """That of the category; ``fast`` looks but a little. Raises InputError where --weights is of another one."""
        config = omad.EstimatorConfig.fast() if fast else None
        estimator = omad.Estimator.from_pretrained(self.weights or self.category, self.device, config, **settings)
        self.check_weights(estimator.category)
        return estimator

    def check_weights(self, found: Category) -> None:
        """Raises InputError where --weights is of another category than asked for."""
        check_category("--weights", self.weights, found, self.category)


@dataclass(frozen=True, kw_only=True)
class CategoriesCommand:
    """A command that works with the weights of several categories."""

    categories: Annotated[tuple[str, ...], tyro.conf.arg(aliases=[ALIASES["categories"]])] = ()
    """Default: all with weights."""
    weights: Path | None = None
    """Folder with a sub-folder a category in place of the shipped weights, or the checkpoint of one category. In a
    checkpoint lie prior/, and of the baselines ancsh/ and siamese/: what is not there is left out."""
    device: Device = "cpu"
    json: Json = False

    def estimators(self) -> Iterator[tuple[Path, omad.Estimator]]:
        """Folders of checkpoints, one a category, with what is made of them. Raises InputError where there is none."""
        for folder in checkpoints(self.weights, self.categories):
            yield folder, omad.Estimator.from_pretrained(folder, self.device)


SHARD = 256
"""Images in each file, where none are asked for."""


@dataclass(frozen=True)
class Cluster:
    """Work in shards."""

    cluster: bool = False
    """In shards, on the Ray cluster that RAY_ADDRESS names, else on all cores of this machine, however many --workers;
    without Ray (pip install 'omad[cluster]') in as many processes. --output is then a folder, or an address that
    fsspec knows (s3://...), of Parquet files; shards that are there are not made again."""
    shard: int | None = None
    """With --cluster: images in each file; default: 256."""

    def asked(self, **others: object) -> bool:
        """Whether to work in shards. Raises InputError for options, and ``others`` that are not None, which are given
        and go with that alone."""
        given = [name for name, value in {"shard": self.shard, **others}.items() if value is not None]
        if given and not self.cluster:
            raise InputError(f"--{given[0]}: goes with --cluster alone; add that, or leave it out")
        return self.cluster

    def run(self, work: Work, total: int, output: Path, made_of: dict[str, Any], workers: int, device: str) -> Sharded:
        """Make all shards. Raises InputError, WorkError."""
        shard = SHARD if self.shard is None else self.shard
        check_positive(shard=shard)
        plan = Plan(Store.of(output), work, total, shard)
        return Sharded(plan, run_shards(plan, made_of, choose_engine(workers, gpus=float(device == "cuda"))))


def check_unused(options: Any, because: str) -> None:
    """Raises InputError for one of the ``options`` that was given, and has no effect."""
    for field in fields(options):
        if getattr(options, field.name) != field.default:
            raise InputError(f"--{field.name.replace('_', '-')}: {because}; leave it out")


MADE = ("procedural", "unusual", "mirrored")
"""Sources that are no files, even where files are called so."""


def everywhere(name: Any) -> Any:
    """A path as another process finds it, whatever folder it works in; all else as it is."""
    there = isinstance(name, str | Path) and name not in MADE and is_path(name)
    return type(name)(Path(name).absolute()) if there else name


@dataclass(frozen=True)
class Models:
    """The object models to measure on."""

    source: str = "procedural"
    """procedural, unusual (its odd members), mirrored (of the other hand, which no prior knows), a generator of your
    own (.py), or a folder of URDF / PartNet-Mobility models."""
    objects: int = 20
    """Procedural objects a category."""
    seed: Seed = 0

    def load(self, category: Category) -> ModelSource:
        """Models that no training has seen."""
        return load_models(self.source, category, self.objects, "test", self.seed)


@dataclass(frozen=True)
class Views:
    """The views to measure on."""

    source: str = "procedural"
    """procedural, unusual (its odd members), mirrored (of the other hand), a generator of your own (.py), a folder of
    models, an ArtImage root (its test split), or what ``omad render`` made: its folder, or with --cluster its
    address."""
    objects: int = 200
    """Procedural objects a category, at most as many as views: those of one object err alike."""
    views: int = 200
    """A category, dealt out to the objects; ``omad eval`` takes all of a rendered folder or an ArtImage root."""
    seed: Seed = 0
    depth_noise: DepthNoise = "off"
    broken: BrokenFiles = "refuse"

    @property
    def total(self) -> int:
        """Views that are drawn of object models."""
        return self.views

    def check(self) -> None:
        check_positive(objects=self.objects, views=self.views)

    def load(self, category: Category, skip: int = 0) -> ViewSource:
        """To measure on; without the first ``skip``."""
        drawn = (self.objects, self.total, self.seed, self.depth_noise)
        return load_views(self.source, category, *drawn, self.broken, skip)

    def spread(self, category: Category) -> ViewSource:
        """So many views, evenly over all that the source has."""
        return self.load(category).spread(self.views)

    def identity(self, found: ViewSource) -> dict[str, str]:
        """Tells these views from others; the first of those that were ``found`` are taken out."""
        settings = {"objects": self.objects, "views": self.views, "seed": self.seed, "noise": self.depth_noise}
        settings |= {"made_of": found.made_of, "models": digest_of_models(found.models)}
        first = list(islice(found.views, 3))
        return {"data": data_identity(first, self.source, settings), "version": omad.__version__}


def checkpoints(weights: Path | None, names: Sequence[str] = ()) -> list[Path]:
    """Folders of the checkpoints in ``weights``, or of the shipped ones: one a category, of those named or of all. What
    is itself a checkpoint stands alone. Raises InputError where there is none."""
    folder = weights or checkpoint.WEIGHTS
    if checkpoint.is_checkpoint(folder):
        if names and [*names] != [own := checkpoint.category_of(OmadNet, folder).name]:
            others = ", ".join(name for name in names if name != own)
            raise InputError(f"--weights {folder}: is for {own}, not for {others}; change it or --categories")
        return [folder]
    names = names or sorted(path.parent.name for path in folder.glob("*/config.json"))
    if not names:
        raise InputError(f"{folder}: no <category>/config.json in it; give a folder with one checkpoint a category")
    of = dict[str, str]()
    for name in names:
        if not checkpoint.is_checkpoint(folder / name):
            cure = "put blanks between categories" if "," in name else "see omad info, or give --weights"
            raise InputError(f"{name}: no weights in {folder / name}; {cure}")
        own = checkpoint.category_of(OmadNet, folder / name).name
        if (first := of.setdefault(own, name)) != name:
            raise InputError(f"{folder}: {first} and {name} are both for {own}; leave one of them out")
    return [folder / name for name in names]


def generable(names: Sequence[str]) -> tuple[str, ...]:
    """Those categories, each once, or all that can be generated. Raises InputError where one of them cannot be."""
    known = procedural.GENERATORS
    if unknown := [name for name in names if name not in known]:
        cure = "put blanks between categories" if "," in unknown[0] else f"choose among {', '.join(known)}"
        raise InputError(f"{unknown[0]}: cannot be generated; {cure}")
    return tuple(dict.fromkeys(names)) or known


def load_prior(folder: Path, device: str) -> PriorNet:
    """The prior's network of a checkpoint ``folder`` of its own. Raises InputError."""
    return checkpoint.load(PriorNet, folder).to(pick_device(device))


def shipped_prior(category: str) -> Path:
    """The checkpoint folder of a category's. Raises InputError where there is none."""
    if omad.get_category(category).name not in checkpoint.shipped_categories():
        cure = "run omad train prior, then give --prior its folder"
        raise InputError(f"{category} has no shipped prior: {cure}")
    return checkpoint.find_weights(category) / "prior"


def prior_of(weights: Path, device: str) -> PriorNet:
    """The prior's network that lies in the checkpoint folder of other ``weights``. Raises InputError."""
    if not checkpoint.is_checkpoint(folder := weights / "prior"):
        raise InputError(f"{folder}: is missing; copy there the folder that omad train prior wrote for these weights")
    prior, category = load_prior(folder, device), checkpoint.category_of(OmadNet, weights)
    own = checkpoint.load_part(OmadPrior(category), "prior.", weights)
    if prior_fingerprint(prior.prior, prior.category) != prior_fingerprint(own, category):
        raise InputError(f"{folder}: is not the prior that {weights} was trained with; copy that one there")
    return prior


LIMITED = {name: "objects" for name in ("objects", "variants", "strangers", "gallery")}
LIMITED |= {name: "views" for name in ("views", "queries", "draws")}
"""Options that are counts, and the limit of each."""


def check_positive(**options: float | None) -> None:
    """Raises InputError for an option that is not above zero, and for more than a machine can bear (``LIMITED``);
    None is an option that was not given."""
    for name, value in options.items():
        if value is not None and not (0 < value <= LARGEST and (isinstance(value, int) or value >= 1 / LARGEST)):
            if value > LARGEST:
                raise InputError(f"--{name.replace('_', '-')} {shown(value)}: must be at most {LARGEST:g}")
            need = "at least 1" if isinstance(value, int) else "a number above 0"
            raise InputError(f"--{name.replace('_', '-')} {value}: must be {need}")
        if value is not None and name in LIMITED:
            check_limit(LIMITED[name], value, f"--{name}")


def check_workers(workers: int) -> int:
    """How many that are. Raises InputError for a negative number."""
    if workers < 0:
        raise InputError(f"--workers {workers}: must be at least 1, or 0 for one a core")
    return min(workers, MOST_THREADS) or cores()


def check_seed(seed: int) -> None:
    """Raises InputError for a number that no generator takes."""
    if not 0 <= seed < 2**32:
        raise InputError(f"--seed {shown(seed)}: must be a whole number from 0, below 2**32")


def check_category(option: str, folder: Path | str | None, found: Category, wanted: str) -> None:
    """Raises InputError where the checkpoint ``folder`` given with ``option`` is of another category than wanted: of
    another name, or trained with a spec file whose parts and joints were others."""
    spec = read_spec(wanted) if is_spec_file(wanted) else None
    name = spec.name if spec else wanted
    if found.name != name:
        raise InputError(f"{option} {folder}: is for {found.name}, not for {name}; change it or --category")
    if spec and _learned(spec) != _learned(found):
        raise InputError(f"{wanted}: parts or joints changed since {option} {folder} was trained; train it anew")
    if spec and [joint.limits for joint in spec.joints] != [joint.limits for joint in found.joints]:
        tell(f"omad: {wanted}: limits changed since {option} {folder} was trained; those of the weights count")


def _learned(category: Category) -> tuple[Any, ...]:
    """What a checkpoint cannot do without: where this changes, its numbers mean something else."""
    parts = [(part.name, part.keypoints, part.mirror) for part in category.parts]
    joints = [(joint.type, joint.parent, joint.axis, joint.rest, joint.pitch) for joint in category.joints]
    return category.metres_per_unit, category.basis_size, parts, joints


def use_threads(threads: int) -> None:
    """Make the process one that trains on so many CPU threads; 0: PyTorch's choice. Raises InputError."""
    if not 0 <= threads <= MOST_THREADS:
        raise InputError(f"--threads {shown(threads)}: must be from 1 to {MOST_THREADS}, or 0 for PyTorch's choice")
    keep_freed_memory()
    if threads:
        set_num_threads(threads)
