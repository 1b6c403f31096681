"""Surfaces of estimated objects: the bank's templates, chosen and fitted."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Self
from weakref import WeakValueDictionary

import numpy as np
import torch

from omad.common.arrays import as_numpy
from omad.common.errors import InputError
from omad.common.runtime import undisturbed, undrawn
from omad.geometry.mesh import Mesh
from omad.objects.category import Category
from omad.objects.pose import ObjectPose

from ..fitting.posed_object import PosedObject, posed_objects
from ..fitting.state import State
from ..prior import OmadPrior
from .bank import ShapeBank, bank_beside
from .fitting import Cloud, FitConfig, SurfaceFit
from .following import followed
from .placed import Placed
from .template import Template


@dataclass(frozen=True, eq=False)
class PosedSurface:
    """Surfaces of an object's parts, as the answer that they were fitted for carries them.

    The fit moves pose and joint states, too, but the answer stays what it is, and an export must not speak of two
    poses. So each part's rest mesh takes up what the fit and the answer differ by: at the answer's pose and joint
    states every part lies exactly where it was fitted, and from there it moves as the answer's joints say. The price:
    parts that touch at rest may be apart, or in one another, by that difference, 1 to 3 per cent of the object's
    diagonal. Rest meshes are no farther from the true object for it: docs/surfaces.md compares the ways."""

    parts: tuple[Mesh, ...]
    """Canonical space at rest, metres."""
    found: ObjectPose
    """The answer's: carries ``parts`` to where they were fitted. Metres, camera frame."""
    placed: ObjectPose
    """Where the fit has the object, with joint states, axes and pivots of its own."""

    def mirrored(self, turning: Sequence[bool]) -> PosedSurface:
        """Their image in the camera's plane x = 0; ``turning`` as ``Category`` has it."""
        parts = tuple(part.mirrored() for part in self.parts)
        return PosedSurface(parts, self.found.mirrored(turning), self.placed.mirrored(turning))

    def posed(self) -> tuple[Mesh, ...]:
        """Each part's surface where it is, camera frame."""
        return tuple(part.carried(T) for part, T in zip(self.parts, self.found.T_camera_part, strict=True))


@dataclass(frozen=True, eq=False)
class FittedSurface(PosedSurface):
    """A surface that was fitted to a cloud."""

    step: np.ndarray
    """(P,) from what was found before to where it is, in the order of ``State``; category units."""


@dataclass(frozen=True)
class SurfaceConfig:
    """How surfaces are chosen."""

    candidates: int = 24
    """Objects with the nearest keypoints, that are held against the cloud."""
    part_candidates: int = 12
    """Objects in which the keypoints of the base, or of all that moves, are nearest: these parts may be theirs."""
    likeness: float = 0.2
    """What the RMS distance of an object's own keypoints from the estimate's counts beside its distance from the
    cloud: it speaks of what is hidden."""
    fit: FitConfig = FitConfig()
    """How each of them is fitted to the cloud."""


class Surfaces:
    """Of one category's objects."""

    def __init__(
        self, prior: OmadPrior, category: Category, load: Callable[[], ShapeBank], config: SurfaceConfig | None = None
    ) -> None:
        """``load`` is called at the first use."""
        self.category, self.config = category, config or SurfaceConfig()
        self._prior, self._load = prior, load
        self._file: Path | None = None

    @classmethod
    def beside(cls, folder: Path, prior: OmadPrior, category: Category) -> Self | None:
        """Those of a checkpoint's folder; None where it has no bank."""
        path = bank_beside(folder)
        if path is None:
            return None
        found = cls(prior, category, partial(_shared, path.absolute(), category, prior))
        found._file = path.absolute()
        return found

    def __getstate__(self) -> dict[str, Any]:
        """For pickles and copies: of a bank in a file only where that is, so that an answer stays small."""
        if self._file is None:
            return vars(self)
        # arrays, as workers would hand over tensors in files that stay open
        weights = {name: as_numpy(value) for name, value in self._prior.state_dict().items()}
        return {"file": self._file, "category": self.category, "config": self.config, "weights": weights}

    def __setstate__(self, state: dict[str, Any]) -> None:
        if "weights" not in state:
            vars(self).update(state)
            return
        file, category, weights = state["file"], state["category"], state["weights"]
        with undrawn():
            prior = OmadPrior(category, weights["learned_basis"].shape[-1], len(weights["joint_hidden.bias"]))
        prior.load_state_dict({name: torch.as_tensor(value) for name, value in weights.items()})
        self.__init__(prior.requires_grad_(False), category, partial(_shared, file, category, prior), state["config"])
        self._file = file

    @cached_property
    def bank(self) -> ShapeBank:
        """The objects that surfaces are taken from. Raises InputError for a file that is no bank of this prior."""
        return self._load()

    @cached_property
    def _doubles(self) -> OmadPrior:
        with undrawn():
            mine = OmadPrior(self.category, self._prior.shape_size, self._prior.joint_hidden.out_features).double()
        mine.load_state_dict(self._prior.state_dict())
        return mine.requires_grad_(False)

    @undisturbed()
    def of_keypoints(self, canonical_keypoints: np.ndarray) -> tuple[Mesh, ...]:
        """Each part's surface (canonical space at rest, metres) for keypoints (M, 3), metres: that of the object with
        the nearest ones, carried along."""
        unit = self.category.metres_per_unit
        keypoints = canonical_keypoints / unit
        template = self.bank.template(self.bank.nearest(keypoints, 1)[0][0])
        return _in_metres(template.at(keypoints), unit)

    @undisturbed()
    def of_beta(self, beta: Any, of_other_hand: Any = False) -> list[tuple[Mesh, ...]]:
        """The same for shape parameters (B, D), NumPy or torch, or for one object's (D,), which count as a batch of
        one. ``of_other_hand``: one bool, or (B,), as estimates have it: the mirror image of what ``beta`` says. Raises
        InputError for other shapes, and for numbers that are not finite."""
        size, given, hands = self._prior.basis_size, as_numpy(beta), as_numpy(of_other_hand)
        if given.ndim not in (1, 2) or given.shape[-1] != size or given.dtype.kind not in "iuf":
            raise InputError(f"beta: shape {given.shape} of {given.dtype}; give numbers ({size},) or (B, {size})")
        if not np.isfinite(given).all():
            raise InputError("beta: some numbers are not finite; give those of an estimate")
        rows = np.atleast_2d(given).astype(np.float64)
        if hands.dtype != bool or hands.shape not in ((), rows.shape[:1]):
            raise InputError(f"of_other_hand: shape {hands.shape} of {hands.dtype}; give a bool, or ({len(rows)},)")
        keypoints = self._doubles.keypoints(torch.as_tensor(rows)).numpy() * self.category.metres_per_unit
        found = [self.of_keypoints(each) for each in keypoints]
        mirrored = np.broadcast_to(hands, len(rows))
        return [
            tuple(part.mirrored() for part in parts) if other else parts
            for parts, other in zip(found, mirrored, strict=True)
        ]

    @undisturbed()
    def fitted(
        self, found: PosedObject, covariance: np.ndarray, points: np.ndarray, labels: np.ndarray
    ) -> FittedSurface:
        """The surface of an object that was found in a cloud (N, 3), camera frame, metres, with parts ``labels`` (N,),
        below zero where none. ``covariance`` (P, P) of what was found: metres and radians.

        Objects with near keypoints are held against the cloud, and the best is fitted to it, with pose and joint
        states; its base and what moves may be of two objects. Where the bank says so, it follows what is seen of the
        parts beyond what these objects are. Without any point of the object the nearest one
        is carried over."""
        return self.fitted_each(found, covariance, points, labels, (self.bank.follows,))[0]

    @undisturbed()
    def fitted_each(
        self,
        found: PosedObject,
        covariance: np.ndarray,
        points: np.ndarray,
        labels: np.ndarray,
        follows: Sequence[bool],
    ) -> list[FittedSurface]:
        """``fitted`` of one fit, whatever the bank says: for each of ``follows``, with what is seen followed or not."""
        unit, config = self.category.metres_per_unit, self.config
        cloud = Cloud.of(points / unit, labels, config.fit.most)
        if cloud is None or not np.isfinite(covariance).all():
            parts, still = self.of_keypoints(found.canonical_keypoints), np.zeros(len(covariance))
            return [FittedSurface(parts, found.placed, found.placed, still)] * len(follows)
        scale, start = self.category.tangent_units(len(found.beta)), self._state(found)
        covariance = covariance / scale[:, None] / scale
        fit = SurfaceFit.of(self._doubles, self.category.limits, start, covariance, cloud, config.fit)
        placed = fit.begin()
        placed = fit(placed, self.bank.template(self.bank.nearest(placed.keypoints, 1)[0][0]))
        best = self._chosen(fit, placed)
        placed = fit(placed, best)
        where = self._metric(placed)
        moved = np.linalg.inv(found.placed.T_camera_part) @ where.T_camera_part
        surfaces = []
        for each in follows:
            parts = followed(fit, placed, best) if each else best.at(placed.keypoints)
            parts = tuple(part.carried(T) for part, T in zip(_in_metres(parts, unit), moved, strict=True))
            surfaces.append(FittedSurface(parts, found.placed, where, placed.moved))
        return surfaces

    @undisturbed()
    def towards(self, found: PosedObject, fitted: FittedSurface, share: np.ndarray) -> PosedObject:
        """What was found, so far on its way to what was fitted to it: ``share`` (P,) of the step."""
        step = torch.as_tensor(share * fitted.step)[None]
        return posed_objects(self._doubles, self.category, self._state(found).moved(step))[0]

    def _chosen(self, fit: SurfaceFit, placed: Placed) -> Template:
        """Of the objects with near keypoints the one that lies best on the cloud; then the base, and all that moves,
        each of that object with which the whole lies best, of those in which their keypoints are near."""
        bank, config, base = self.bank, self.config, self.bank.of_part[0].stop
        near, unlike = bank.nearest(placed.keypoints, config.candidates)
        found = [bank.template(index) for index in near]
        best = found[self._least(fit, placed, found, unlike)]
        for some, keypoints in ((slice(1), slice(base)), (slice(1, None), slice(base, None))):
            near, unlike = bank.nearest(placed.keypoints, config.part_candidates, keypoints)
            found = [best, *(best.with_parts(some, bank.template(index)) for index in near)]
            off = np.concatenate([part.known for part in best.parts[some]]) - placed.keypoints[keypoints]
            own = np.sqrt(np.square(off).sum(1).mean())
            best = found[self._least(fit, placed, found, np.append(own, unlike))]
        return best

    def _least(self, fit: SurfaceFit, placed: Placed, found: list[Template], unlike: np.ndarray) -> int:
        apart = [fit.apart(placed, template) for template in found]
        return int(np.argmin(apart + self.config.likeness * unlike))

    def _state(self, found: PosedObject) -> State:
        T = found.placed.T_camera_part[0].copy()
        T[:3, 3] /= self.category.metres_per_unit
        values = found.beta, found.placed.states / self.category.state_units, T
        return State(*(torch.as_tensor(value, dtype=torch.float64)[None] for value in values))

    def _metric(self, placed: Placed) -> ObjectPose:
        unit, pose = self.category.metres_per_unit, placed.pose
        T = pose.T_camera_part.copy()
        T[:, :3, 3] *= unit
        states = pose.states * self.category.state_units
        return replace(pose, states=states, pivots=pose.pivots * unit, T_camera_part=T)


_banks: WeakValueDictionary[tuple[Any, ...], ShapeBank] = WeakValueDictionary()
"""Those in use, by file, what it is read for, and when it was written."""


def _shared(path: Path, category: Category, prior: OmadPrior) -> ShapeBank:
    """A bank, read once for all who use it at a time: answers from other processes come one by one. Raises InputError,
    as ``ShapeBank.load`` does."""
    written = path.stat().st_mtime_ns if path.is_file() else None
    key = path, written, category, as_numpy(prior.learned_basis).tobytes()
    found = _banks.get(key)
    if found is None:
        _banks[key] = found = ShapeBank.load(path, category, prior)
    return found


def _in_metres(parts: Sequence[Mesh], unit: float) -> tuple[Mesh, ...]:
    return tuple(part.warped(lambda vertices: vertices * unit) for part in parts)
