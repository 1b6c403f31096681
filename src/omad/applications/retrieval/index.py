"""A catalogue of objects that is asked by shape. One file holds it, whole or not at all."""

import hashlib
import io
import json
import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from numbers import Integral
from pathlib import Path
from typing import Any, Literal, Self, get_args
from zipfile import BadZipFile, ZipFile

import numpy as np

from omad.common.decode import Shape
from omad.common.errors import InputError
from omad.common.files import write_atomic, writing
from omad.common.incoming import check_file, check_seal, decoded, existing, parse_json, read_arrays, readable
from omad.common.limits import check_limit

from .search import ExactSearch, GraphSearch, Neighbours
from .signature import Metric, Signature, Space, information_factor

FORMAT = "omad-index-2"
Backend = Literal["exact", "faiss"]
MOST_ASKED = 1000
"""Entries among which objects of the query's own hand are looked for."""


@dataclass(frozen=True, slots=True)
class Entry:
    """What a catalogue says of one signature. Several entries may name the same object."""

    name: str
    """Of the object."""
    source: str = ""
    """Where it came from: a file, say."""
    thumbnail: bytes = b""
    """A small PNG; empty where there is none."""
    of_other_hand: bool | None = None
    """Whether the object is the mirror image of what its signature says, where that is sure. Left out, it is that of
    the signature."""

    def __post_init__(self) -> None:
        if not (isinstance(self.name, str) and isinstance(self.source, str) and isinstance(self.thumbnail, bytes)):
            raise InputError("entry: name and source are texts, its thumbnail the bytes of a PNG; give such")
        if not isinstance(self.of_other_hand, bool | None):
            raise InputError(f"entry: of_other_hand is {self.of_other_hand!r}; give True, False, or None")

    def mirrored(self, signature: Signature) -> bool | None:
        """Whether the object is of another hand than that of a signature; None where either is not known surely."""
        known = self.of_other_hand is not None and signature.of_other_hand is not None
        return self.of_other_hand != signature.of_other_hand if known else None


def check_entries(entries: Sequence[Entry]) -> None:
    """Raises InputError for what are none, as names alone."""
    for entry in entries:
        if not isinstance(entry, Entry):
            raise InputError(f"entry: is {type(entry).__name__}; give omad.applications.retrieval.index.Entry(name)")


def with_hands(signatures: Sequence[Signature], entries: Sequence[Entry]) -> list[Entry]:
    """Entries that say themselves of which hand their objects are, where their signatures do."""
    pairs = zip(signatures, entries, strict=True)
    return [
        replace(entry, of_other_hand=own.of_other_hand) if entry.of_other_hand is None else entry
        for own, entry in pairs
    ]


@dataclass(frozen=True)
class Hit:
    """One entry of an answer."""

    entry: Entry
    """What the catalogue says of it."""
    distance: float
    """In the space's measure: metres between keypoints, units of beta, or standard deviations."""
    mirrored: bool | None = None
    """Whether it is of another hand than the query, so that distance is that to its mirror image; None where the
    category has one hand, or one of the two is not told surely."""


class ShapeIndex:
    """Signatures of one prior with their entries.

    index = ShapeIndex(Space.of(net.prior, net.category))
    index.add(signatures, entries)
    hits = index.search(signature, count=5)
    """

    def __init__(self, space: Space, backend: Backend = "exact") -> None:
        """Raises InputError for another backend."""
        if backend not in get_args(Backend):
            raise InputError(f"backend {backend!r}: no such backend; choose of {', '.join(get_args(Backend))}")
        self.space, self.backend = space, backend
        self.entries: list[Entry] = []
        self._betas = np.zeros((0, len(space.factor)), dtype=np.float32)
        self._covariances = np.zeros_like(space.factor)
        self._added: list[np.ndarray] = []
        self._search: ExactSearch | GraphSearch | None = None

    def __len__(self) -> int:
        return len(self.entries)

    @property
    def betas(self) -> np.ndarray:
        """(N, D) float32, in the order of ``entries``."""
        if self._added:
            self._betas, self._added = np.concatenate([self._betas, *self._added]), []
        return self._betas

    @property
    def usual_covariance(self) -> np.ndarray:
        """(D, D) mean of the entries'; those of unknown covariance, as of object models, count as certain."""
        return self._covariances / max(len(self), 1)

    def add(self, signatures: Iterable[Signature], entries: Iterable[Entry]) -> None:
        """Add objects. Raises InputError for a signature of another prior, and for what are no signatures or
        entries."""
        signatures, entries = [*signatures], [*entries]
        if len(signatures) != len(entries):
            raise InputError(f"{len(signatures)} signatures for {len(entries)} entries; give one each")
        check_entries(entries)
        for signature in signatures:
            self.space.check(signature)
        if signatures:
            self.add_betas(np.stack([signature.beta for signature in signatures]), with_hands(signatures, entries))
            known = [signature.covariance for signature in signatures if signature.covariance is not None]
            self._covariances = self._covariances + sum(known)

    def add_betas(self, betas: np.ndarray, entries: Sequence[Entry]) -> None:
        """``add`` for many at a time: betas (n, D) that are known to be of this prior."""
        check_entries(entries)
        betas = np.array(betas, dtype=np.float32)  # the caller's may change
        if betas.shape != (len(entries), len(self.space.factor)) or not np.isfinite(betas).all():
            raise InputError(f"betas: expected finite ({len(entries)}, {len(self.space.factor)}), got {betas.shape}")
        self._added.append(betas)
        self.entries += entries
        self._search = None

    def search(self, signature: Signature, count: int = 10, by_information: bool = False) -> list[Hit]:
        """The ``count`` nearest entries, nearest first. ``by_information`` weighs every direction of beta by how surely
        this one query and the entries know it (distances are then in standard deviations); all entries are compared,
        whatever the backend. Raises InputError for a signature of another prior, and where its covariance is needed
        and not known."""
        self.space.check(signature)
        count = whole(count)
        if by_information:
            if signature.covariance is None:
                raise InputError("the query's covariance is not known; leave out the weighting by information")
            factor = information_factor(signature.covariance, self.usual_covariance)
            found = ExactSearch(self.betas @ factor.T).nearest((factor @ signature.beta)[None], count)
        else:
            found = self.nearest(signature.beta[None], count)
        pairs = zip(found.rows[0], found.distances[0].tolist(), strict=True)
        return [hit_of(self.entries[row], distance, signature) for row, distance in pairs if row >= 0]

    def search_objects(self, signature: Signature, count: int = 10, by_information: bool = False) -> list[Hit]:
        """As ``search``, but every object once, by its nearest entry, and mirror images behind objects of the query's
        own hand (``nearest_objects``)."""
        return nearest_objects(lambda asked: self.search(signature, asked, by_information), count, len(self))

    def nearest(self, betas: np.ndarray, count: int) -> Neighbours:
        """Rows and distances of the nearest entries of many queries (Q, D) of this prior, as many as there are."""
        count = min(count, len(self))
        if not count:
            return Neighbours(np.zeros((len(betas), 0), dtype=np.int64), np.zeros((len(betas), 0)))
        if self._search is None:
            vectors = self.space.vectors(self.betas)
            self._search = GraphSearch.of(vectors) if self.backend == "faiss" else ExactSearch(vectors)
        return self._search.nearest(self.space.vectors(betas), count)

    def save(self, path: str | Path) -> None:
        """Write one file in place of the index that was there; a crash leaves the old one. Raises InputError where
        something else is."""
        check_place(path)
        if self.backend == "faiss":
            self.nearest(self.betas[:1], 1)  # builds the graph, if that is not done
        head = {name: getattr(self.space, name) for name in ("prior", "category", "metric")}
        head |= {"format": FORMAT, "backend": self.backend}
        head |= {"names": [entry.name for entry in self.entries], "sources": [entry.source for entry in self.entries]}
        if any(hands := [entry.of_other_hand for entry in self.entries]) or False in hands:
            head["hands"] = hands
        pictures = [entry.thumbnail for entry in self.entries]
        arrays = {"factor": self.space.factor, "betas": self.betas, "covariances": self._covariances}
        arrays["thumbnails"] = np.frombuffer(b"".join(pictures), dtype=np.uint8)
        arrays["thumbnail_sizes"] = np.array([*map(len, pictures)], dtype=np.int64)
        if isinstance(self._search, GraphSearch):
            arrays["graph"] = self._search.to_bytes()
        head["sha256"] = _digest(arrays)
        arrays["head"] = np.frombuffer(json.dumps(head).encode(), dtype=np.uint8)

        def write(temporary: Path) -> None:
            with temporary.open("wb") as file:
                np.savez(file, allow_pickle=False, **arrays)
                file.flush()
                os.fsync(file.fileno())  # the name must not be on the disk before the content is

        write_atomic(path, write)

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read what ``save`` wrote. Raises InputError for a missing, damaged or foreign file."""
        cure = "build it anew"
        path = existing(path, "an index, as omad index build makes it")
        arrays = read_arrays(path, "an index", cure)
        if not isinstance(arrays, dict) or "head" not in arrays:
            raise InputError(f"{path}: not an index; {cure}")
        values = parse_json(arrays.pop("head").tobytes(), path, cure)
        if not isinstance(values, dict) or values.get("format") != FORMAT:
            found = values.get("format") if isinstance(values, dict) else None
            raise InputError(f"{path}: format {found!r} is not {FORMAT}; {cure}")
        head = decoded(_Head, values, path, cure)
        with readable(path, "an index (a part of it is missing or wrong)", cure):
            if head.sha256 is not None:
                check_seal(head.sha256, _digest(arrays), path, cure)
            return cls._of(head, arrays)

    @classmethod
    def _of(cls, head: "_Head", arrays: dict[str, np.ndarray]) -> Self:
        """Raises anything for parts that do not fit together."""
        count, size = len(head.names), len(arrays["factor"])
        check_limit("catalogue", count, "the index")
        factor, covariances = (Shape(size, size).array(arrays[name]) for name in ("factor", "covariances"))
        betas, sizes = Shape(count, size).array(arrays["betas"]), arrays["thumbnail_sizes"]
        if sizes.shape != (count,) or sizes.dtype.kind != "i" or not (sizes >= 0).all():
            raise ValueError("thumbnail_sizes")
        hands = (None,) * count if head.hands is None else head.hands
        if sizes.sum() != arrays["thumbnails"].nbytes or not len(head.sources) == len(hands) == count:
            raise ValueError("thumbnails, sources and hands")
        index = cls(Space(head.prior, head.category, head.metric, factor), head.backend)
        pictures = io.BytesIO(arrays["thumbnails"].tobytes())
        columns = zip(head.names, head.sources, sizes.tolist(), hands, strict=True)
        index.add_betas(betas, [Entry(name, source, pictures.read(size), hand) for name, source, size, hand in columns])
        index._covariances = covariances
        # a graph is for FAISS to read, which trusts it: one without a checksum is made anew
        if "graph" in arrays and head.sha256 is not None:
            index._search = GraphSearch.from_bytes(arrays["graph"])
        return index


def check_place(path: str | Path) -> None:
    """Raises InputError where something is that an index would take the place of, and that is none itself."""
    path = Path(path)
    with writing(path):
        if path.exists() and path.stat().st_size and not _is_index(path):  # of an empty file nothing is lost
            raise InputError(f"{path}: is there, and is no file of an index; choose another name, or delete it")


def _is_index(path: Path) -> bool:
    try:
        check_file(path)
        with ZipFile(path) as file:
            return "head.npy" in file.namelist()
    except (BadZipFile, OSError, InputError):
        return False


def whole(count: Any) -> int:
    """How many hits are asked for. Raises InputError for what is no such number."""
    if not isinstance(count, Integral) or count < 1:
        raise InputError(f"count {count}: give a whole number from 1")
    return int(count)


def hit_of(entry: Entry, distance: float, query: Signature) -> Hit:
    """An entry at a distance from the query."""
    return Hit(entry, distance, entry.mirrored(query))


def nearest_objects(search: Callable[[int], list[Hit]], count: int, entries: int) -> list[Hit]:
    """The ``count`` nearest objects, each by its nearest entry, of a catalogue of so many ``entries``; ``search`` gives
    as many of the nearest of them as it is asked for. Mirror images come last, and only where there are not as many
    objects of the query's own hand among ``MOST_ASKED`` entries."""
    asked = count
    while True:
        hits = search(asked)
        ranked = sorted(hits, key=lambda hit: (hit.mirrored is True, hit.distance))
        objects = {hit.entry.name: hit for hit in reversed(ranked)}  # the nearest entry is the last to be kept
        own = sum(hit.mirrored is not True for hit in objects.values())
        enough = own >= count or (len(objects) >= count and asked >= MOST_ASKED)
        if enough or asked >= entries or len(hits) < asked:
            return sorted(objects.values(), key=lambda hit: (hit.mirrored is True, hit.distance))[:count]
        asked = min(4 * asked, entries)


@dataclass(frozen=True)
class _Head:
    """What an index's file says of itself."""

    format: str
    prior: str
    category: str
    metric: Metric
    backend: Backend
    names: tuple[str, ...]
    sources: tuple[str, ...]
    sha256: str | None = None
    hands: tuple[bool | None, ...] | None = None
    """Of categories whose objects are of either hand; files of earlier versions do not say."""


def _digest(arrays: dict[str, np.ndarray]) -> str:
    digest = hashlib.sha256()
    for name in sorted(arrays):
        digest.update(f"{name} {arrays[name].dtype} {arrays[name].shape}".encode())
        digest.update(np.ascontiguousarray(arrays[name]).data)
    return digest.hexdigest()
