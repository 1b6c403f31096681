"""Entries of a catalogue from object models, from views, and from people's own depth images and clouds."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from omad.common.batches import batched
from omad.common.errors import InputError, shown
from omad.data.rendering.standard_views import View
from omad.estimation.estimate import Estimate
from omad.estimation.estimator import Estimator
from omad.model.priornet import PriorNet
from omad.objects.model import ObjectModel
from omad.sensing.observation import Observation

from .index import Entry
from .picture import model_thumbnail, view_thumbnail
from .signature import Signature, estimate_signature, fuse, model_signatures, prior_fingerprint

BATCH = 32


@dataclass(frozen=True)
class Seen:
    """One observation that goes into a catalogue."""

    name: str
    """Of the object; several observations may be of the same."""
    source: str
    observation: Observation
    mirrored: bool = False
    """The object is the mirror image of what the observation shows."""


@dataclass
class Catalogued:
    """Signatures with their entries, and what could not be taken in."""

    signatures: list[Signature] = field(default_factory=list)
    entries: list[Entry] = field(default_factory=list)
    refused: list[dict[str, str]] = field(default_factory=list)
    """Name and reason of each."""
    doubtful: list[dict[str, Any]] = field(default_factory=list)
    """Name, source and probability of entries that are rather wrong than right: all of their views are doubtful."""


def from_models(net: PriorNet, models: Sequence[ObjectModel], source: str) -> Catalogued:
    """One entry a model; its signature is PriorNet's, which sees the whole surface."""
    own = [model.mirrored() if model.of_other_hand else model for model in models]
    entries = [Entry(model.name, source, model_thumbnail(model)) for model in own]
    signatures = model_signatures(net, models)
    if net.category.either_hand:
        told = [float(model.of_other_hand) for model in models]
        signatures = [replace(one, mirrored_probability=hand) for one, hand in zip(signatures, told, strict=True)]
    return Catalogued(signatures, entries)


def from_observations(estimator: Estimator, seen: Iterable[Seen], fused: bool) -> Catalogued:
    """An entry an observation, or with ``fused`` one an object, from all observations that bear its name,
    with the picture of its first one."""
    prior, found = prior_fingerprint(estimator.net.prior, estimator.category), Catalogued()
    rows: dict[str, list[int]] = {}
    doubted: list[float | None] = []
    for some in batched(seen, BATCH):
        for thing, estimate in zip(some, estimator([thing.observation for thing in some]), strict=True):
            rows.setdefault(thing.name, []).append(len(found.entries))
            doubted.append(estimate.probability if estimate.doubtful else None)
            signature = estimate_signature(estimate, prior)
            found.signatures.append(signature.in_mirror() if thing.mirrored else signature)
            found.entries.append(Entry(thing.name, thing.source, _thumbnail(thing, estimate)))
    groups = [*rows.values()] if fused else [[row] for row in range(len(found.entries))]
    for own in groups:
        doubts = [low for row in own if (low := doubted[row]) is not None]
        if len(doubts) == len(own):
            entry = found.entries[own[0]]
            found.doubtful.append({"name": entry.name, "source": entry.source, "probability": max(doubts)})
    if not fused:
        return found
    signatures = [fuse([found.signatures[row] for row in own]) for own in groups]
    return replace(found, signatures=signatures, entries=[found.entries[own[0]] for own in groups])


def _thumbnail(thing: Seen, estimate: Estimate) -> bytes:
    """The estimated object, or where its surface is not known what was seen of it."""
    if estimate.surfaces is None or not estimate.is_finite:
        return view_thumbnail(thing.observation)
    model = estimate.carried_model()
    return model_thumbnail(model.mirrored() if thing.mirrored else model)


def seen_views(views: Iterable[tuple[int, View]], source: str, refused: list[dict[str, str]]) -> Iterator[Seen]:
    """Observations of rendered views with their numbers; those that show too little are added to ``refused``."""
    for number, view in views:
        try:
            observation = view.observation()
        except InputError as error:
            refused.append({"name": f"{view.object} (view {number})", "reason": str(error)})
            continue
        yield Seen(view.object, source, observation, view.truth.of_other_hand)


def object_of(file: Path, root: Path) -> str:
    """What object a file shows: its sub-folder of ``root`` says it, or its own name where it lies in ``root``."""
    inside = file.relative_to(root)
    return inside.parts[0] if len(inside.parts) > 1 else file.stem


def check_objects_apart(files: Sequence[Path], root: Path) -> None:
    """Raises InputError for a file of ``root`` itself that is called like another, or like a sub-folder: its object
    would be taken for theirs."""
    firsts: dict[str, Path] = {}
    for file in files:
        first = firsts.setdefault(name := object_of(file, root), file)
        if first != file and root in (first.parent, file.parent):
            cure = "rename one, or lay all views of one object into a sub-folder"
            raise InputError(f"{file}: is object {shown(name)}, as is {first}; {cure}")
