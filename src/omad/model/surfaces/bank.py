"""Objects that a prior knows whole: the keypoints of each, and its surface when it is asked for.

Objects of a generator are kept as their numbers and made again; others are kept with their meshes. A bank is the file
``surfaces.npz`` beside a checkpoint.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np

from omad.common.arrays import as_numpy, digest_of
from omad.common.decode import Shape
from omad.common.errors import InputError
from omad.common.files import write_atomic
from omad.common.incoming import CHECKSUM, check_seal, read_arrays, readable
from omad.data.procedural import generate
from omad.geometry.mesh import Mesh
from omad.objects.category import Category
from omad.objects.model import ObjectModel

from ..checkpoint import shipped_categories
from ..prior import OmadPrior
from .shares import Shares
from .template import Template

FILE = "surfaces.npz"
"""What a bank is called, in the folder of a checkpoint."""
REMEMBERED = 256
"""Templates that are kept once they are made."""
ROUNDED = 1e-3
"""By how much numbers of a basis may differ: some weights are stored with fewer digits."""


@dataclass(frozen=True, eq=False)
class ShapeBank:
    """N objects of a category."""

    category: Category
    """Of which they are."""
    basis: np.ndarray
    """(L, 3, D) learned by the prior whose keypoints these are."""
    keypoints: np.ndarray
    """(N, M, 3) float32, canonical space at rest, category units."""
    meshes: Sequence[tuple[Mesh, ...]] = ()
    """Of each object, a part each, canonical space, metres; none where the generator makes them."""
    shares: Shares | None = None
    """How far answers go towards the fits; None where it was not measured."""
    follows: bool = False
    """Whether surfaces follow what is seen beyond what these objects are (``following``)."""
    _made: dict[int, Template] = field(default_factory=dict, repr=False)

    def __len__(self) -> int:
        return len(self.keypoints)

    @cached_property
    def of_part(self) -> tuple[slice, ...]:
        """Which of all keypoints are each part's."""
        ends = np.cumsum([0, *(part.keypoints for part in self.category.parts)]).tolist()
        return tuple(map(slice, ends, ends[1:]))

    def nearest(self, keypoints: np.ndarray, count: int, some: slice = slice(None)) -> tuple[np.ndarray, np.ndarray]:
        """The ``count`` objects of whose keypoints ``some`` are nearest to those of ``keypoints`` (M, 3), nearest
        first, and the RMS distances (count,)."""
        away = (self.keypoints[:, some] - keypoints[some]).reshape(len(self), -1)
        apart = np.einsum("nk,nk->n", away, away) / len(keypoints[some])
        found = np.argsort(apart, kind="stable")[:count]
        return found, np.sqrt(apart[found])

    def template(self, index: int) -> Template:
        """Object ``index``; made at its first use. Several threads may ask."""
        index = int(index)
        found = self._made.get(index)
        if found is None:
            unit, known = self.category.metres_per_unit, self.keypoints[index].astype(np.float64)
            found = Template.of(self._object(index), unit, known, self.of_part)
            if len(self._made) >= REMEMBERED:
                oldest, *_ = self._made  # in one step, as another thread may put one in
                self._made.pop(oldest, None)
            self._made[index] = found
        return found

    def _object(self, index: int) -> ObjectModel:
        if not self.meshes:
            return generate(self.category, index)
        joints = len(self.category.joints)
        nowhere = np.zeros((joints, 3))
        return ObjectModel.of(self.category, str(index), self.meshes[index], nowhere, nowhere)

    def save(self, folder: Path) -> Path:
        """Write ``surfaces.npz`` into a checkpoint's ``folder``."""
        arrays: dict[str, Any] = {"basis": self.basis, "keypoints": self.keypoints.astype(np.float16)}
        if self.meshes:
            parts = [part for parts in self.meshes for part in parts]
            arrays["vertices"] = np.concatenate([part.vertices for part in parts]).astype(np.float32)
            arrays["faces"] = np.concatenate([part.faces for part in parts]).astype(np.int32)
            arrays["counts"] = np.array([(len(part.vertices), len(part.faces)) for part in parts])
        if self.shares is not None:
            arrays |= self.shares.arrays()
        arrays["follows"] = np.array(self.follows)
        arrays[CHECKSUM] = np.array(digest_of(arrays))
        path = folder / FILE
        write_atomic(path, lambda file: np.savez_compressed(file, allow_pickle=False, **arrays))
        return path

    @classmethod
    def load(cls, path: Path, category: Category, prior: OmadPrior) -> Self:
        """Read one that was made with ``prior``. Raises InputError for anything else."""
        cure = f"make it anew: {train_command(category)}"
        arrays = read_arrays(path, "a bank of surfaces", cure)
        with readable(path, "a bank of surfaces", cure):
            assert isinstance(arrays, dict)
            if CHECKSUM in arrays:
                check_seal(str(arrays.pop(CHECKSUM)), digest_of(arrays), path, cure)
            wanted = Shape(None, category.num_keypoints, 3)
            known, basis = wanted.array(arrays["keypoints"]).astype(np.float32), arrays["basis"]
            meshes, shares = _meshes(arrays, len(category.parts)), Shares.among(arrays, len(category.joints))
            follows = "follows" in arrays and bool(arrays["follows"])
            if not len(known) or (meshes and len(meshes) != len(known)):
                raise ValueError("keypoints and meshes are not of the same objects")
        found = cls(category, basis, known, meshes, shares, follows)
        found.check_prior(prior, path)
        return found

    def check_prior(self, prior: OmadPrior, path: Path) -> None:
        """Raises InputError, for a bank in the file ``path``, where it was made with another prior."""
        mine = as_numpy(prior.learned_basis)
        if self.basis.shape != mine.shape or not np.allclose(self.basis, mine, rtol=0, atol=ROUNDED):
            cure = f"make it anew: {train_command(self.category)}"
            raise InputError(f"{path}: was made with another prior than these weights; {cure}")

    @classmethod
    def of_models(
        cls, category: Category, prior: OmadPrior, keypoints: Any, models: Sequence[ObjectModel], generated: bool
    ) -> Self:
        """Of ``models`` with their keypoints (N, M, 3); ``generated``: they are the first N that the generator
        makes to train with."""
        meshes = () if generated else [model.parts for model in models]
        return cls(category, as_numpy(prior.learned_basis).copy(), as_numpy(keypoints), meshes)


def _meshes(arrays: dict[str, np.ndarray], parts: int) -> list[tuple[Mesh, ...]]:
    """Raises anything for arrays that do not fit together."""
    if "counts" not in arrays:
        return []
    counts, vertices, faces = arrays["counts"], Shape(None, 3).array(arrays["vertices"]), arrays["faces"]
    whole = len(counts) % parts == 0 and counts.min() > 0 and counts.sum(0).tolist() == [len(vertices), len(faces)]
    if not whole or faces.dtype.kind != "i" or faces.ndim != 2 or faces.shape[1] != 3:
        raise ValueError("counts: are not those of vertices (V, 3) and faces (F, 3)")
    ends = np.cumsum(counts, 0)[:-1]
    split = zip(np.split(vertices, ends[:, 0]), np.split(faces, ends[:, 1]), strict=True)
    each = [Mesh(v, f.astype(np.int64)) for v, f in split]
    if not all(mesh.faces.min() >= 0 and mesh.faces.max() < len(mesh.vertices) for mesh in each):
        raise ValueError("faces: name vertices that are not there")
    return [tuple(each[i : i + parts]) for i in range(0, len(each), parts)]


def train_command(category: Category) -> str:
    """What makes a bank, as a person types it; of a category that has no shipped weights all must be named."""
    if category.name in shipped_categories():
        return f"omad train surface --category {category.name} (of weights of your own: with --weights W --prior P)"
    of_own = f"where SPEC is the spec file of {category.name}, W and P are the folders of its weights and their prior"
    models = "S is its generator, or a folder of models, with --unseen U, others to measure on"
    return f"omad train surface --category SPEC --weights W --prior P --source S, {of_own}, and {models}"


def bank_beside(folder: Path) -> Path | None:
    """The bank of a checkpoint, or of the one that it lies in, if any."""
    return next((path for path in (folder / FILE, folder.parent / FILE) if path.is_file()), None)
