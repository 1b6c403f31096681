"""``omad estimate`` and ``omad detect``: objects in depth images and clouds of one's own camera."""

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
from .options import BUILT_IN, OWN, CategoriesCommand, CategoryCommand, Fast, check_positive

with lazy_imports():
    from numpy import array, stack

    from omad.applications.detection import picture as detection_picture
    from omad.applications.detection.detector import Detector
    from omad.estimation import world
    from omad.estimation.category_ranking import Candidate, rank, suspected
    from omad.estimation.checks import Check, doubts
    from omad.estimation.several_views import contradictions
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
    together: tuple[Path, ...] = ()
    """T_world_camera of every input, a file each, in their order: the inputs are views of one object at one moment, and
    get one answer."""
    gravity: str | None = None
    """Of an object that stands upright: x,y,z, where down is in the camera frame (y is down in a level camera); or
    world, for --world or --together with z up."""
    fast: Fast = False
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
        poses = self._poses(len(files))
        known, auto = _known(self.gravity, poses[0] if poses else None), self.category == AUTO
        if auto and (self.weights is not None or self.together):
            option = "--together" if self.together else "--weights"
            raise InputError(f"--category auto: does not go with {option}; leave that out, or name a category")
        solver = _Solver(None if auto else self.estimator(self.fast), known, self.compare, self.device)
        if self.together:
            read = [_Read.of(file, name, reader) for file, name in zip(files, _folder_names(files), strict=True)]
            found = solver.together([view.observation for view in read], poses, self.reading.depth_scale)
            results = [self._finish(*row) for row in zip(read, found, poses, strict=True)]
            code = 0 if all(result["converged"] for result in results) else 1
            return Answer({"results": results, "refused": []}, results_text, code)
        results, refused = [], []
        for file, name in zip(files, _folder_names(files), strict=True):
            try:
                view = _Read.of(file, name, reader)
            except InputError as error:
                if one:
                    raise
                print(f"omad: {error}", file=sys.stderr)
                refused.append({"input": str(file), "reason": str(error)})
                continue
            found = solver(view.observation, _metres_per_number(file, self.reading.depth_scale))
            results.append(self._finish(view, found, poses[0] if poses else None))
        code = 2 if refused else 0 if any(result["converged"] for result in results) else 1
        if one:
            return Answer(results[0], joints_text, code)
        return Answer({"results": results, "refused": refused}, results_text, code)

    def _poses(self, inputs: int) -> list[Any]:
        """T_world_camera of all inputs; of the one camera; or none. Raises InputError."""
        if not self.together:
            return [] if self.world is None else [read_transform(self.world, "T_world_camera")]
        if self.world is not None:
            raise InputError("--together: tells where the cameras are; leave out --world")
        if len(self.together) != inputs:
            raise InputError(f"--together: {len(self.together)} poses for {inputs} inputs; give one file for each")
        return [read_transform(file, "T_world_camera") for file in self.together]

    def _finish(self, view: _Read, found: _Found, T_world_camera: Any) -> dict[str, Any]:
        """Write the answer to one input; what is said of it."""
        folder = self.output / view.name
        found.estimate.seconds["read"] = view.seconds
        record = found.to_dict()
        if T_world_camera is not None:
            record["world"] = world.in_world(found.estimate, T_world_camera)
        self._write(view.observation, found, folder, view.file)
        write_json(folder / "estimate.json", record)
        return {"input": str(view.file), "output": str(folder), **record}

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


@dataclass(frozen=True, kw_only=True)
class Detect(CategoriesCommand):
    """Find all objects of a depth image or cloud by themselves, without a mask: what stands on a table or floor is cut
    out, and each thing is judged by all categories. One JSON and one picture with all of them.

    Things that are of none of the categories are listed, too. What lies flat on a table, as scissors do, cannot be told
    from it by depth: give ``omad estimate`` a mask. Things that touch are taken for one.
    """

    input: tyro.conf.Positional[Path]
    """Depth image (PNG, TIFF, NPY, NPZ) or cloud (PLY, PCD, XYZ, NPY, NPZ) of a whole scene."""
    intrinsics: str | None = None
    """Of the depth camera: fx,fy,cx,cy or a file, as for ``omad estimate``."""
    box: str | None = None
    """x1,y1,x2,y2 in pixels, half-open: objects are looked for inside."""
    depth_scale: float | None = None
    """Metres per stored number; default 0.001 for integer images, 1 for floats and clouds."""
    output: Path = Path("omad-detect")
    """Folder for detect.json and detect.png."""

    def run(self) -> Answer:
        check_positive(depth_scale=self.depth_scale)
        options = InputOptions(intrinsics=self.intrinsics, depth_scale=self.depth_scale)
        frame = InputReader.of(options, [self.input])(self.input)
        corners = None if self.box is None else parse_numbers(self.box, 4, "--box")
        began = time.perf_counter()
        detector = Detector([estimator for _, estimator in self.estimators()])
        loaded = time.perf_counter()
        found = detector(frame, corners)
        seconds = {"load": loaded - began, "detect": time.perf_counter() - loaded}
        record = {"input": str(self.input), "objects": [one.to_dict() for one in found], "seconds": seconds}
        write_json(self.output / "detect.json", record | {"warnings": list(frame.warnings)})
        picture.save(detection_picture.figure(frame, found, self.input.name), self.output / "detect.png")
        named = sum(one.category is not None for one in found)
        print(f"{self.input}: {named} objects, {len(found) - named} other things -> {self.output}", file=sys.stderr)
        return Answer(record, detections_text)


def detections_text(answer: dict[str, Any]) -> str:
    """What was found in a frame, a line a thing."""
    rows = [["", "category", "sure", "box", "centre (m)", "joints"]]
    for number, found in enumerate(answer["objects"], 1):
        joints = found["estimate"]["joints"] if found["estimate"] else []
        states = ", ".join(f"{joint['name']} {state_and_std(joint)}" for joint in joints) or "-"
        box = "-" if found["box"] is None else ",".join(map(str, found["box"]))
        name = found["category"] or "none of these"
        rows.append([str(number), name, f"{found['probability']:.0%}", box, _vector(found["centre"]), states])
    return table(rows)


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
class _Read:
    """One input."""

    file: Path
    name: str
    """Of its folder among the results."""
    observation: omad.Observation
    seconds: float

    @classmethod
    def of(cls, file: Path, name: str, reader: InputReader) -> _Read:
        """Raises InputError."""
        began = time.perf_counter()
        observation = reader(file)
        return cls(file, name, observation, time.perf_counter() - began)


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

    def together(
        self, views: Sequence[omad.Observation], poses: Sequence[Any], depth_scale: float | None
    ) -> list[_Found]:
        """Views of one object, by the category asked for."""
        assert self.chosen is not None
        estimates = self.chosen(views, self.known, T_world_camera=stack(poses))
        rows = zip(views, estimates, strict=True)
        return [_Found(e, [*doubts(view, e, depth_scale), *contradictions(e)], []) for view, e in rows]

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
        raise InputError("--gravity world: needs --world FILE (or --together) with T_world_camera, z up")
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
