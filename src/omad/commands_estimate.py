"""``omad estimate``: objects in depth images and clouds of one's own camera."""

from __future__ import annotations

import json as json_module
import os
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tyro

from .auto_category import Candidate, rank
from .camera_files import read_transform
from .categories import CATEGORIES
from .checklist import Check, doubts, suspected
from .checkpoint import shipped_categories
from .errors import InputError
from .estimate import Estimate as Answer
from .estimator import Estimator
from .exports.formats import Format, save_formats
from .files import MILLIMETRES, is_cloud, write_atomic
from .html_report import save_html
from .inputs import FrameOptions, InputReader, input_files, parse_numbers
from .known import Known
from .observation import Observation
from .options import Device, Json, Result, Weights, check_category, check_positive
from .report import describe, figure, save
from .world import gravity_in_camera, in_world

AUTO = "auto"
CategoryOrAuto = Annotated[
    str,
    tyro.conf.arg(
        help=f"{', '.join(CATEGORIES)}; auto: all of them are tried, and ranked by how well they explain what is seen;"
        " or your own: a spec file (.toml, .json), or the name in --weights."
    ),
]


@dataclass(frozen=True)
class Estimate:
    """Estimate objects from depth images (PNG, TIFF, NPY, NPZ) or clouds (PLY, PCD, XYZ, NPY, NPZ): JSON, URDF, a
    picture and a page for the browser (estimate.html, with sliders) each.

    Where a result is doubtful a list of what to check is printed, and kept under "checks" of the JSON.
    """

    inputs: tyro.conf.Positional[tuple[Path, ...]]
    """Files, or folders of them. A bad one of many is named on stderr and under "refused" of the JSON; the others,
    under "results", are done, and the exit code is 2."""
    category: CategoryOrAuto
    intrinsics: str | None = None
    """Of the depth camera: fx,fy,cx,cy or a file (Open3D or RealSense JSON, ROS YAML, 3x3 text). A lens that the file
    tells of is undone."""
    distortion: str | None = None
    """The depth camera's lens in place of that: k1,k2,p1,p2,k3 as OpenCV orders them, equidistant:k1,k2,k3,k4, or none
    for images that are undistorted already."""
    mask: Path | None = None
    """Image, non-zero where the object is; or a folder with a mask for each input, of the same name."""
    box: str | None = None
    """x1,y1,x2,y2 in pixels around the object, half-open."""
    color_intrinsics: str | None = None
    """As --intrinsics, of the colour camera: --mask and --box then belong to its image, and depth stays unaligned."""
    color_extrinsics: Path | None = None
    """T_color_depth, depth camera to colour camera in metres: 4x4 text or NPY, or JSON with rotation and translation
    as librealsense writes them."""
    segment: Literal["plane"] | None = None
    """plane: take away the dominant plane and keep the largest thing on it."""
    drop_flying: bool = False
    """Leave out stray points that fly between fore- and background."""
    depth_scale: float | None = None
    """Metres per stored number; default 0.001 for integer images, 1 for floats and clouds."""
    world: Path | None = None
    """T_world_camera, 4x4 text or NPY, or JSON with it: the answer is given in the world frame, too."""
    gravity: str | None = None
    """Of an object that stands upright: x,y,z, where down is in the camera frame (y is down in a level camera); or
    world, for --world with z up."""
    compare: bool = False
    """Compare with the other categories even where nothing is doubtful."""
    output: Path = Path("omad-estimate")
    """Folder for results, one sub-folder an input."""
    formats: tuple[Format, ...] = ()
    """Write these, too: urdf (in the camera frame, with masses), ply, glb (animated), ros (JSON), rrd (Rerun)."""
    weights: Weights = None
    device: Device = "cpu"
    json: Json = False

    def run(self) -> Result:
        check_positive(depth_scale=self.depth_scale)
        files = input_files(self.inputs)
        one = len(self.inputs) == 1 and files[0] == self.inputs[0]
        frame = FrameOptions(self.distortion, self.color_intrinsics, self.color_extrinsics, self.drop_flying)
        reader = InputReader.of(self, files, frame)
        T_world_camera = None if self.world is None else read_transform(self.world, "T_world_camera")
        solver = _Solver.of(self, self._known(T_world_camera))
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
            seconds = time.perf_counter() - began
            found = solver(observation, self._scale(file))
            found.estimate.seconds["read"] = seconds
            answer = found.to_dict()
            if T_world_camera is not None:
                answer["world"] = in_world(found.estimate, T_world_camera)
            self._write(observation, found, answer, self.output / name, file)
            results.append({"input": str(file), "output": str(self.output / name), **answer})
        code = 2 if refused else 0 if any(result["converged"] for result in results) else 1
        return code, results[0] if one else {"results": results, "refused": refused}

    def _known(self, T_world_camera: np.ndarray | None) -> Known:
        if self.gravity is None:
            return Known()
        if self.gravity != "world":
            down = np.array(parse_numbers(self.gravity, 3, "--gravity"))
            if not 0 < np.linalg.norm(down) < np.inf:
                raise InputError(f"--gravity {self.gravity}: has no direction; give x,y,z in the camera frame")
            return Known(gravity=down)
        if T_world_camera is None:
            raise InputError("--gravity world: needs --world FILE with T_world_camera, z up")
        return Known(gravity=gravity_in_camera(T_world_camera))

    def _scale(self, file: Path) -> float | None:
        """Metres per stored number, where that can be told from the file's name."""
        if self.depth_scale is not None:
            return self.depth_scale
        return 1.0 if is_cloud(file) else MILLIMETRES if file.suffix.lower() == ".png" else None

    def _write(self, observation: Observation, found: _Found, answer: dict[str, Any], folder: Path, file: Path) -> None:
        """All files of one input, and what a person should read of it on stderr."""
        estimate = found.estimate
        estimate.save_urdf(folder / "object.urdf")
        save(figure(observation, estimate, title=file.name), folder / "estimate.png")
        checks = tuple(str(check) for check in found.checks)
        page = replace(estimate, warnings=observation.warnings + checks)
        save_html(observation, page, folder / "estimate.html", title=file.name)
        text = json_module.dumps(answer) + "\n"
        write_atomic(folder / "estimate.json", lambda temporary: temporary.write_text(text))
        save_formats(estimate, observation, folder, self.formats)
        joints = ", ".join(describe(joint) for joint in estimate.joints)
        name = f"{estimate.category.name}: " if self.category == AUTO else ""
        doubt = "" if estimate.converged else " (not converged)"
        print(f"{file}: {name}{joints}{doubt} -> {folder}", file=sys.stderr)
        for warning in observation.warnings:
            print(f"{file}: warning: {warning}", file=sys.stderr)
        if found.checks:
            print(f"{file}: doubtful; check:", file=sys.stderr)
        for check in found.checks:
            print(f"  [ ] {check.name}: {check.what}\n      why: {check.why}\n      do:  {check.cure}", file=sys.stderr)


@dataclass(frozen=True)
class _Found:
    """The answer to one input."""

    estimate: Answer
    checks: list[Check]
    ranked: list[Candidate]
    """All categories, best first, where they were compared."""

    def to_dict(self) -> dict[str, Any]:
        answer = {**self.estimate.to_dict(), "checks": [check.to_dict() for check in self.checks]}
        if self.ranked:
            answer["categories"] = [candidate.to_dict() for candidate in self.ranked]
        return answer


@dataclass(frozen=True)
class _Solver:
    """Estimates with one category, or with the one of several that explains an observation best."""

    command: Estimate
    known: Known
    loaded: dict[str, Estimator]
    """By category; the others are loaded when they are first needed."""

    @classmethod
    def of(cls, command: Estimate, known: Known) -> _Solver:
        solver = cls(command, known, {})
        if command.category != AUTO:
            estimator = Estimator.from_pretrained(command.weights or command.category, command.device)
            check_category("--weights", command.weights, estimator.category, command.category)
            solver.loaded[estimator.category.name] = estimator
        elif command.weights is not None:
            raise InputError("--category auto: compares the shipped weights; leave out --weights, or name a category")
        return solver

    def __call__(self, observation: Observation, depth_scale: float | None) -> _Found:
        if self.command.category == AUTO:
            ranked = rank(observation, self._all(), self.known)
            return _Found(ranked[0].estimate, doubts(observation, ranked[0].estimate, depth_scale), ranked)
        estimate = next(iter(self.loaded.values()))(observation, self.known)
        checks, ranked = doubts(observation, estimate, depth_scale), []
        if checks or self.command.compare:
            ranked = rank(observation, self._all(), self.known)
            checks += suspected(estimate, ranked)
        return _Found(estimate, checks, ranked)

    def _all(self) -> Sequence[Estimator]:
        for name in shipped_categories():
            if name not in self.loaded:
                self.loaded[name] = Estimator.from_pretrained(name, self.command.device)
        return list(self.loaded.values())


def _folder_names(files: Sequence[Path]) -> list[str]:
    """A folder's name for each file: its stem, or where files share that, a longer name that tells them apart."""
    places = [Path(os.path.abspath(file)) for file in files]
    for names in (
        [place.stem for place in places],
        [place.name for place in places],
        [f"{place.parent.name}-{place.name}" for place in places],
    ):
        if len(set(names)) == len(names):
            return names
    return [f"{number:05d}-{place.name}" for number, place in enumerate(places)]
