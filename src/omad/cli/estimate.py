"""``omad estimate`` and ``omad detect``: objects in depth images and clouds of one's own camera."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import tyro
from tyro.conf import OmitArgPrefixes

import omad
from omad.common.errors import InputError, as_line, named
from omad.common.files import check_folder, replacing, write_json
from omad.common.lazy import lazy_imports
from omad.objects.builtin import AUTO
from omad.sensing.input_options import CameraOptions, FrameOptions, InputOptions

from .answer import Answer, state, state_and_std, table
from .options import BUILT_IN, OWN, CategoriesCommand, CategoryCommand, Fast, ToSurface, check_positive, checkpoints

with lazy_imports():
    from omad.applications.detection import picture as detection_picture
    from omad.applications.detection.detector import Detector, called
    from omad.applications.solver import Found, Solver
    from omad.common.incoming import read_json
    from omad.estimation import world
    from omad.estimation.categories.late import AnyEstimator, LateEstimator, shipped_estimators
    from omad.estimation.categories.ranking import Ranking
    from omad.estimation.estimate import chance
    from omad.objects.category import Category
    from omad.output import picture
    from omad.output.formats import check_formats, files_of_answer, save_formats
    from omad.output.page import save_html
    from omad.sensing.camera_files import read_transform
    from omad.sensing.reader import InputReader, input_files

CHOICE = (
    f"{BUILT_IN}; auto: the likeliest are tried, with the one of --weights where these are given, and ranked by how"
    f" well they explain what is seen; {OWN}"
)
NEAR = 0.2
"""A category with this probability is named beside the likeliest one."""
ESTIMATE = "estimate.json"
EXIT_DOUBTFUL = 1
"""Exit code of --strict."""


@dataclass(frozen=True, kw_only=True)
class EstimateCommand(CategoryCommand):
    """Estimate objects from depth images (PNG, TIFF, PFM, PGM, NPY, NPZ) or clouds (PLY, PCD, XYZ, NPY, NPZ): JSON,
    URDF, a picture and a page for the browser (estimate.html, with sliders) each.

    Of a whole frame without a mask the thing before table, floor and walls is taken that is most like the category.
    Where a result is doubtful a list of what to check is printed, and kept under "checks" of the JSON. With --category
    auto the answer may be that it is of none of the categories: "category" is then null.
    """

    inputs: tyro.conf.Positional[tuple[Path, ...]]
    """Files, or folders of them. A bad one of many is named on stderr and under "refused" of the JSON; the others,
    under "results", are done, and the exit code is 2."""
    category: Annotated[str, tyro.conf.arg(help=CHOICE)]
    reading: OmitArgPrefixes[InputOptions] = InputOptions()
    frame: OmitArgPrefixes[FrameOptions] = FrameOptions()
    world: Path | None = None
    """T_world_camera, 4x4 text or NPY, or JSON with it: the answer is given in the world frame, z up, too, and
    --formats are written in it."""
    together: tuple[Path, ...] = ()
    """T_world_camera of every input, a file each, in their order: the inputs are views of one object at one moment, and
    get one answer."""
    gravity: str | None = None
    """Of an object that stands upright: x,y,z, where down is in the camera frame (y is down in a level camera); or
    world, for --world or --together with z up."""
    fast: Fast = False
    to_surface: ToSurface = False
    strict: bool = False
    """Exit with code 1 where an answer is doubtful: rather wrong than right, by its probability."""
    compare: bool = False
    """Compare with the other categories even where nothing is doubtful."""
    output: Path = Path("omad-estimate")
    """Folder for results, one sub-folder an input."""
    formats: tuple[str, ...] = ()
    """Write these, too, in the camera's frame or that of --world: urdf (with masses), mjcf (MuJoCo), usd, ply, glb
    (animated), ros (JSON), rrd (Rerun)."""

    def run(self) -> Answer:
        check_positive(depth_scale=self.reading.depth_scale)
        check_folder(self.output)
        check_formats(self.formats)
        files = input_files(self.inputs)
        one = len(self.inputs) == 1 and files[0] == self.inputs[0]
        reader = InputReader.of(self.reading, files, self.frame)
        poses = self._poses(len(files))
        known, auto = world.known_gravity(self.gravity, poses[0] if poses else None), self.category == AUTO
        if auto and self.together:
            raise InputError("--category auto: does not go with --together; leave that out, or name a category")
        if self.to_surface and self.together:
            raise InputError("--to-surface: each of several views would go its own way; leave it or --together out")
        if self.compare and self.together:
            raise InputError("--compare: is for single views; leave it or --together out")
        own = None if auto and self.weights is None else self.estimator(self.fast)
        chosen = None if auto else own
        check_formats(self.formats, chosen and chosen.category)
        every = partial(_all_categories, own, self.device, self.fast)
        solver = Solver(chosen, every, known, self.compare, self.to_surface)
        reader = replace(reader, find=solver.find)
        if self.together:
            read = [_Read.of(file, name, reader) for file, name in zip(files, _folder_names(files), strict=True)]
            found = solver.together([view.observation for view in read], poses, self.reading.depth_scale)
            results = [self._finish(*row) for row in zip(read, found, poses, strict=True)]
            return Answer({"results": results, "refused": []}, results_text, self._code(results, all))
        results, refused = [], []
        for file, name in zip(files, _folder_names(files), strict=True):
            try:
                view = _Read.of(file, name, reader)
                with named(file):
                    found = solver(view.observation, reader.metres_per_number(file))
                    if not found.none:
                        check_formats(self.formats, found.estimate.category)
            except InputError as error:
                if one:
                    raise
                print(f"omad: {error}", file=sys.stderr)
                refused.append({"input": str(file), "reason": str(error)})
                continue
            results.append(self._finish(view, found, poses[0] if poses else None))
        code = 2 if refused else self._code(results, any)
        if one:
            return Answer(results[0], joints_text, code)
        return Answer({"results": results, "refused": refused}, results_text, code)

    def check_weights(self, found: Category) -> None:
        """With --category auto they may be of any: theirs is one of those that are tried."""
        if self.category != AUTO:
            super().check_weights(found)

    def _code(self, results: Sequence[dict[str, Any]], enough: Callable[[Iterable[bool]], bool]) -> int:
        """The exit code of so many results, where it is ``enough`` of them that have to be answers."""
        if not enough(result["converged"] or result["category"] is None for result in results):
            return 1
        return EXIT_DOUBTFUL if self.strict and any(result["doubtful"] for result in results) else 0

    def _poses(self, inputs: int) -> list[Any]:
        """T_world_camera of all inputs; of the one camera; or none. Raises InputError."""
        if not self.together:
            if self.world is not None and inputs > 1:
                print(f"omad: {inputs} inputs and one --world: the camera is taken to stand still", file=sys.stderr)
            return [] if self.world is None else [_pose(self.world)]
        if self.world is not None:
            raise InputError("--together: tells where the cameras are; leave out --world")
        if len(self.together) != inputs:
            raise InputError(f"--together: {len(self.together)} poses for {inputs} different inputs; give one for each")
        return [_pose(file) for file in self.together]

    def _finish(self, view: _Read, found: Found, T_world_camera: Any) -> dict[str, Any]:
        """Write the answer to one input; what is said of it."""
        folder, found = self.output / view.name, found.with_seconds(read=view.seconds)
        with replacing(_earlier(folder)):
            if found.none:
                record = found.none_of_them()
                _say(f"{view.file}: none of the categories ({nearest_text(record)}) -> {folder}")
            else:
                record = found.to_dict()
                if T_world_camera is not None:
                    record["world"] = world.in_world(found.estimate, T_world_camera)
                self._write(view.observation, found, folder, view.file, T_world_camera)
            write_json(folder / ESTIMATE, record)
        return {"input": str(view.file), "output": str(folder), **record}

    def _write(
        self, observation: omad.Observation, found: Found, folder: Path, file: Path, T_world_camera: Any
    ) -> None:
        """All files of one input but the JSON, and what a person should read of it on stderr."""
        said = observation.warnings + tuple(str(check) for check in found.checks)
        warnings = observation.warnings
        if found.estimate.joints_alone:  # of one of several views: what is said of the others
            warnings += tuple(told for told in found.estimate.warnings if not told.endswith(said))
        doubts = warnings + said[len(observation.warnings) :]
        estimate = replace(found.estimate, warnings=doubts)  # whose surface is fitted once for all files
        estimate.save_urdf(folder / "object.urdf")
        picture.save(picture.figure(observation, estimate, title=file.name), folder / "estimate.png")
        save_html(observation, estimate, folder / "estimate.html", title=file.name)
        save_formats(estimate, observation, folder, self.formats, T_world_camera)
        joints = ", ".join(map(str, estimate.joints))
        name = "" if found.ranking is None or self.category != AUTO else f"{_named(found.ranking)}: "
        notes = [picture.how_sure(estimate), "" if estimate.converged else "not converged"]
        note = ", ".join(filter(None, notes))
        _say(f"{file}: {name}{joints}{note and f' ({note})'} -> {folder}")
        if self.compare and found.ranking is not None:
            _say(f"{file}: of all categories: {_named(found.ranking)}")
        for warning in warnings:
            _say(f"{file}: warning: {warning}")
        if found.checks:
            _say(f"{file}: {'doubtful; ' if found.doubtful else ''}check:")
        for check in found.checks:
            _say(f"  [ ] {check.name}: {check.what}")
            _say(f"      why: {check.why}")
            _say(f"      do:  {check.cure}")


def _say(line: str) -> None:
    """On stderr; a file's name may hold what tells a terminal to do something."""
    print(as_line(line), file=sys.stderr)


def _named(ranking: Ranking) -> str:
    """The category, how likely it is, and the next where that is not far from it."""
    first, *others = ((one.estimate.category.name, one.probability) for one in ranking.candidates)
    near = [f"{name} {chance(probability)}" for name, probability in others[:1] if probability >= NEAR]
    return f"{first[0]} ({'; '.join([chance(first[1]), *near])})"


def _pose(file: Path) -> Any:
    """T_world_camera (4, 4), with a line on stderr where it seems to be in other units. Raises InputError."""
    T_world_camera = read_transform(file, "T_world_camera")
    for doubt in world.unit_doubts(T_world_camera):
        _say(f"omad: warning: {file}: {doubt}")
    return T_world_camera


@dataclass(frozen=True, kw_only=True)
class Detect(CategoriesCommand):
    """Find all objects of a depth image or cloud by themselves, without a mask: what stands on a table or floor is cut
    out, and each thing is judged by all categories. One JSON and one picture with all of them.

    Things that are of none of the categories are listed, too. What lies flat on a table, as scissors do, cannot be told
    from it by depth: give ``omad estimate`` a mask. Things that touch are taken for one.
    """

    input: tyro.conf.Positional[Path]
    """Depth image (PNG, TIFF, PFM, PGM, NPY, NPZ) or cloud (PLY, PCD, XYZ, NPY, NPZ) of a whole scene."""
    intrinsics: str | None = None
    """Of the depth camera: fx,fy,cx,cy or a file, as for ``omad estimate``."""
    box: str | None = None
    """x1,y1,x2,y2 in pixels, half-open: objects are looked for inside."""
    gravity: str | None = None
    """Of objects that stand upright: x,y,z, where down is in the camera frame (y is down in a level camera). Without
    it, cameras that were turned take sides for tops."""
    depth_scale: float | None = None
    """Metres per stored number; default: what the file of --intrinsics or one beside the image tells, else 0.001 for
    integers, and 1 for floats and clouds."""
    camera: OmitArgPrefixes[CameraOptions] = CameraOptions()
    output: Path = Path("omad-detect")
    """Folder for detect.json and detect.png."""

    def run(self) -> Answer:
        check_positive(depth_scale=self.depth_scale)
        check_folder(self.output)
        options = InputOptions(intrinsics=self.intrinsics, box=self.box, depth_scale=self.depth_scale)
        if self.gravity == "world":
            raise InputError("--gravity world: no world is told of here; give x,y,z in the camera frame")
        known = world.known_gravity(self.gravity, None)
        reader = InputReader.of(options, [self.input], FrameOptions(**vars(self.camera)))
        frame, corners = reader.whole(self.input)
        began = time.perf_counter()
        folders = checkpoints(self.weights, self.categories)
        detector = Detector([LateEstimator.of(folder, self.device) for folder in folders], known=known)
        loaded = time.perf_counter()
        look = detector.look(frame, corners)
        found = look.detections
        seconds = {"load": loaded - began, "detect": time.perf_counter() - loaded}
        record = {"input": str(self.input), "objects": [one.to_dict() for one in found], "seconds": seconds}
        plane = None if look.support_plane is None else look.support_plane.tolist()
        record |= {"support_plane": plane, "lowest": look.lowest, "too_flat": look.too_flat}
        doubts = detector.scale_doubts(look, reader.metres_per_number(self.input))
        warnings = [*frame.warnings, *look.doubts, *doubts]
        for warning in warnings:
            print(f"{self.input}: warning: {warning}", file=sys.stderr)
        record["warnings"] = warnings
        write_json(self.output / "detect.json", record)
        picture.save(detection_picture.figure(frame, found, self.input.name), self.output / "detect.png")
        named = sum(one.category is not None for one in found)
        print(f"{self.input}: objects: {named}, other things: {len(found) - named} -> {self.output}", file=sys.stderr)
        return Answer(record, detections_text)


def detections_text(answer: dict[str, Any]) -> str:
    """What was found in a frame, a line a thing."""
    rows = [["", "category", "sure", "box", "centre (m)", "joints"]]
    for number, found in enumerate(answer["objects"], 1):
        joints = found["estimate"]["joints"] if found["estimate"] else []
        states = ", ".join(f"{joint['name']} {state_and_std(joint)}" for joint in joints) or "-"
        box = "-" if found["box"] is None else ",".join(map(str, found["box"]))
        if found["estimate"] and found["estimate"]["doubtful"]:
            states += " (doubtful)"
        name, sure = called(found["likely"]), chance(found["likely_probability"])
        rows.append([str(number), name, sure, box, _vector(found["centre"]), states])
    seen = table(rows) if answer["objects"] else "Nothing stands before table, floor and walls where it was looked."
    if not answer["too_flat"]:
        return seen
    names, limit = " or ".join(answer["too_flat"]), f"{1000 * answer['lowest']:.0f} mm"
    flat = f"{names} may lie unseen: what rises less than about {limit} over a table cannot be told from it by depth"
    return f"{seen}\n{flat}; give omad estimate a mask of it."


def nearest_text(answer: dict[str, Any]) -> str:
    """What is most like a thing that is of none of the categories."""
    return f"probability {chance(answer['none'])}; most like: {answer['categories'][0]['category']}"


def joints_text(answer: dict[str, Any]) -> str:
    """What was found in one input, a line a joint, and how sure that is."""
    if answer["category"] is None:
        return f"none of the categories ({nearest_text(answer)})"
    rows = [["joint", "state", "limits", "travel", "axis", "pivot (m)"]]
    for joint in answer["joints"]:
        limits = " to ".join(state(joint, limit) for limit in joint["limits"])
        places = [_vector(joint["axis"]), _vector(joint["pivot"])]
        rows.append([joint["name"], state_and_std(joint), limits, _travel(joint), *places])
    doubt = ", doubtful" if answer["doubtful"] else ""
    known = answer["probability"] is not None
    return table(rows) + (f"\nright with probability {chance(answer['probability'])}{doubt}" if known else "")


def results_text(answer: dict[str, Any]) -> str:
    """What was found in many inputs, a line a joint."""
    rows = [["input", "joint", "state", "travel", "converged", "doubtful"]]
    for result in answer["results"]:
        said = ["yes" if result[key] else "no" for key in ("converged", "doubtful")]
        rows += [[result["input"], j["name"], state_and_std(j), _travel(j), *said] for j in result["joints"]]
        if result["category"] is None:
            rows.append([result["input"], "none of the categories", "-", "-", *said])
    return table(rows)


def _travel(joint: dict[str, Any]) -> str:
    return "-" if joint["fraction"] is None else f"{round(joint['fraction'], 2) + 0.0:.0%}"  # 0.0: no minus before zero


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


def _all_categories(own: omad.Estimator | None, device: str, fast: bool) -> list[AnyEstimator]:
    """One's own, and those of all other categories with shipped weights."""
    found: list[AnyEstimator] = [own] if own else []
    taken = {estimator.category.name for estimator in found}
    others = shipped_estimators(device, omad.EstimatorConfig.fast() if fast else None)
    return found + [other for other in others if other.category.name not in taken]


def _earlier(folder: Path) -> list[Path]:
    """Where an earlier answer lies in ``folder``, its files but the JSON."""
    try:
        parts = [str(part["name"]) for part in read_json(folder / ESTIMATE, "")["parts"]]
    except (InputError, LookupError, TypeError):  # none of ours
        return []
    return files_of_answer(folder, parts)


def _folder_names(files: Sequence[Path]) -> list[str]:
    """A folder's name for each file: its stem, or where files share that, a longer name that tells them apart."""
    places = [Path(os.path.abspath(file)) for file in files]
    for name in (lambda p: p.stem, lambda p: p.name, lambda p: f"{p.parent.name}-{p.name}"):
        names = [name(place) for place in places]
        apart = {name.casefold() for name in names}  # there are file systems that do not tell capitals
        if len(apart) == len(names) and not apart & {".", ".."}:
            return names
    return [f"{number:05d}-{place.name}" for number, place in enumerate(places)]
