"""``omad estimate``: objects in depth images and clouds of one's own camera."""

from __future__ import annotations

import math
import os
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any

import tyro
from tyro.conf import OmitArgPrefixes

import omad
from omad.common.errors import InputError
from omad.common.files import write_json
from omad.common.lazy import lazy_imports
from omad.sensing.input_options import FrameOptions, InputOptions

from .answer import Answer, state, state_and_std, table
from .options import BUILT_IN, OWN, CategoryCommand, check_positive

with lazy_imports():
    from numpy import array

    from omad.estimation import world
    from omad.estimation.category_ranking import Candidate, rank, suspected
    from omad.estimation.checks import Check, doubts
    from omad.model.checkpoint import shipped_categories
    from omad.output import picture
    from omad.output.formats import check_formats, save_formats
    from omad.output.page import save_html
    from omad.sensing import depth_files
    from omad.sensing.camera_files import read_transform
    from omad.sensing.reader import InputReader, input_files, parse_numbers

AUTO = "auto"
CHOICE = f"{BUILT_IN}; auto: all of them are tried, and ranked by how well they explain what is seen; {OWN}"


@dataclass(frozen=True, kw_only=True)
class EstimateCommand(CategoryCommand):
    """Estimate objects from depth images (PNG, TIFF, NPY, NPZ) or clouds (PLY, PCD, XYZ, NPY, NPZ): JSON, URDF, a
    picture and a page for the browser (estimate.html, with sliders) each.

    Where a result is doubtful a list of what to check is printed, and kept under "checks" of the JSON.
    """

    inputs: tyro.conf.Positional[tuple[Path, ...]]
    """Files, or folders of them. A bad one of many is named on stderr and under "refused" of the JSON; the others,
    under "results", are done, and the exit code is 2."""
    category: Annotated[str, tyro.conf.arg(help=CHOICE)]
    reading: OmitArgPrefixes[InputOptions] = InputOptions()
    frame: OmitArgPrefixes[FrameOptions] = FrameOptions()
    world: Path | None = None
    """T_world_camera, 4x4 text or NPY, or JSON with it: the answer is given in the world frame, too."""
    gravity: str | None = None
    """Of an object that stands upright: x,y,z, where down is in the camera frame (y is down in a level camera); or
    world, for --world with z up."""
    compare: bool = False
    """Compare with the other categories even where nothing is doubtful."""
    output: Path = Path("omad-estimate")
    """Folder for results, one sub-folder an input."""
    formats: tuple[str, ...] = ()
    """Write these, too: urdf (in the camera frame, with masses), ply, glb (animated), ros (JSON), rrd (Rerun)."""

    def run(self) -> Answer:
        check_positive(depth_scale=self.reading.depth_scale)
        check_formats(self.formats)
        files = input_files(self.inputs)
        one = len(self.inputs) == 1 and files[0] == self.inputs[0]
        reader = InputReader.of(self.reading, files, self.frame)
        T_world_camera = None if self.world is None else read_transform(self.world, "T_world_camera")
        known, auto = _known(self.gravity, T_world_camera), self.category == AUTO
        if auto and self.weights is not None:
            raise InputError("--category auto: compares the shipped weights; leave out --weights, or name a category")
        solver = _Solver(None if auto else self.estimator(), known, self.compare, self.device)
        results, refused = [], []
        for file, name in zip(files, _folder_names(files), strict=True):
            began = time.perf_counter()
            try:
                observation = reader(file)
            except InputError as error:
                if one:
                    raise
                print(f"omad: {error}", file=sys.stderr)
                refused.append({"input": str(file), "reason": str(error)})
                continue
            seconds, folder = time.perf_counter() - began, self.output / name
            found = solver(observation, _metres_per_number(file, self.reading.depth_scale))
            found.estimate.seconds["read"] = seconds
            record = found.to_dict()
            if T_world_camera is not None:
                record["world"] = world.in_world(found.estimate, T_world_camera)
            self._write(observation, found, folder, file)
            write_json(folder / "estimate.json", record)
            results.append({"input": str(file), "output": str(folder), **record})
        code = 2 if refused else 0 if any(result["converged"] for result in results) else 1
        if one:
            return Answer(results[0], joints_text, code)
        return Answer({"results": results, "refused": refused}, results_text, code)

    def _write(self, observation: omad.Observation, found: _Found, folder: Path, file: Path) -> None:
        """All files of one input but the JSON, and what a person should read of it on stderr."""
        estimate = found.estimate
        estimate.save_urdf(folder / "object.urdf")
        picture.save(picture.figure(observation, estimate, title=file.name), folder / "estimate.png")
        doubts = observation.warnings + tuple(str(check) for check in found.checks)
        save_html(observation, replace(estimate, warnings=doubts), folder / "estimate.html", title=file.name)
        save_formats(estimate, observation, folder, self.formats)
        joints = ", ".join(map(picture.describe, estimate.joints))
        name = f"{estimate.category.name}: " if self.category == AUTO else ""
        doubt = "" if estimate.converged else " (not converged)"
        print(f"{file}: {name}{joints}{doubt} -> {folder}", file=sys.stderr)
        for warning in observation.warnings:
            print(f"{file}: warning: {warning}", file=sys.stderr)
        if found.checks:
            print(f"{file}: doubtful; check:", file=sys.stderr)
        for check in found.checks:
            print(f"  [ ] {check.name}: {check.what}\n      why: {check.why}\n      do:  {check.cure}", file=sys.stderr)


def joints_text(answer: dict[str, Any]) -> str:
    """What was found in one input, a line a joint."""
    rows = [["joint", "state", "limits", "travel", "axis", "pivot (m)"]]
    for joint in answer["joints"]:
        limits = " to ".join(state(joint, limit) for limit in joint["limits"])
        places = [_vector(joint["axis"]), _vector(joint["pivot"])]
        rows.append([joint["name"], state_and_std(joint), limits, _travel(joint), *places])
    return table(rows)


def results_text(answer: dict[str, Any]) -> str:
    """What was found in many inputs, a line a joint."""
    rows = [["input", "joint", "state", "travel", "converged"]]
    for result in answer["results"]:
        own = result["input"], "yes" if result["converged"] else "no"
        rows += [[own[0], joint["name"], state_and_std(joint), _travel(joint), own[1]] for joint in result["joints"]]
    return table(rows)


def _travel(joint: dict[str, Any]) -> str:
    return "-" if joint["fraction"] is None else f"{joint['fraction']:.0%}"


def _vector(values: list[float] | None) -> str:
    return "-" if values is None else "(" + ", ".join(f"{value:.3f}" for value in values) + ")"


@dataclass(frozen=True)
class _Found:
    """The answer to one input."""

    estimate: omad.Estimate
    checks: list[Check]
    ranked: list[Candidate]
    """All categories, best first, where they were compared."""

    def to_dict(self) -> dict[str, Any]:
        ranked = {"categories": [candidate.to_dict() for candidate in self.ranked]} if self.ranked else {}
        return {**self.estimate.to_dict(), "checks": [check.to_dict() for check in self.checks], **ranked}


@dataclass(frozen=True)
class _Solver:
    """Estimates with one category, or with the one of several that explains an observation best."""

    chosen: omad.Estimator | None
    """Of the category asked for; None: of any."""
    known: omad.Known
    compare: bool
    device: str

    def __call__(self, observation: omad.Observation, depth_scale: float | None) -> _Found:
        if self.chosen is None:
            ranked = rank(observation, self.all, self.known)
            return _Found(ranked[0].estimate, doubts(observation, ranked[0].estimate, depth_scale), ranked)
        estimate = self.chosen(observation, self.known)
        checks, ranked = doubts(observation, estimate, depth_scale), []
        if checks or self.compare:
            ranked = rank(observation, self.all, self.known)
            checks += suspected(estimate, ranked)
        return _Found(estimate, checks, ranked)

    @cached_property
    def all(self) -> list[omad.Estimator]:
        """The one chosen, and those of all other categories with shipped weights."""
        found = [self.chosen] if self.chosen else []
        others = sorted({*shipped_categories()} - {estimator.category.name for estimator in found})
        return found + [omad.Estimator.from_pretrained(name, self.device) for name in others]


def _known(gravity: str | None, T_world_camera: Any) -> omad.Known:
    """What the options say of the object. Raises InputError."""
    if gravity is None:
        return omad.Known()
    if gravity != "world":
        down = parse_numbers(gravity, 3, "--gravity")
        if not 0 < math.hypot(*down) < math.inf:
            raise InputError(f"--gravity {gravity}: has no direction; give x,y,z in the camera frame")
        return omad.Known(gravity=array(down))
    if T_world_camera is None:
        raise InputError("--gravity world: needs --world FILE with T_world_camera, z up")
    return omad.Known(gravity=world.gravity_in_camera(T_world_camera))


def _metres_per_number(file: Path, given: float | None) -> float | None:
    """Of a depth image or cloud, where that can be told from the file's name."""
    if given is not None:
        return given
    return 1.0 if depth_files.is_cloud(file) else depth_files.MILLIMETRES if file.suffix.lower() == ".png" else None


def _folder_names(files: Sequence[Path]) -> list[str]:
    """A folder's name for each file: its stem, or where files share that, a longer name that tells them apart."""
    places = [Path(os.path.abspath(file)) for file in files]
    for name in (lambda p: p.stem, lambda p: p.name, lambda p: f"{p.parent.name}-{p.name}"):
        names = [name(place) for place in places]
        if len(set(names)) == len(names):
            return names
    return [f"{number:05d}-{place.name}" for number, place in enumerate(places)]
