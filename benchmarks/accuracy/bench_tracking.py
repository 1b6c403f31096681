"""How well and how fast an object is followed through frames, beside estimating every frame alone.

    OMP_NUM_THREADS=1 python benchmarks/accuracy/bench_tracking.py [--category dishwasher] [--threads 2] [--json]

Sequences of unseen objects (150 frames of 640x480 at 15 frames a second, camera noise on, joints opening and closing
before a moving camera, 20 frames without the object) are written as 16-bit PNGs and tracked from these. 'alone' is
the full estimator on each frame. Times contain reading the file; process CPU time says what a core that does nothing
else would need. Errors in degrees and centimetres, over the frames that are tracked; jitter is the standard deviation
of the error's difference between neighbouring frames. Shape errors are RMS distances of canonical keypoints from
those of the complete object, in category units.
"""

from __future__ import annotations

import json
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
import tyro
from PIL import Image
from scipy.spatial.transform import Rotation
from sequences import SequenceConfig, SequenceFrame, render_sequence

from omad.applications.tracking.motion import Placement
from omad.applications.tracking.sequence import spread
from omad.applications.tracking.tracker import TrackedEstimate, Tracker
from omad.common.errors import NothingSeen
from omad.common.runtime import keep_freed_memory
from omad.data.procedural import generate
from omad.data.surface_bank import SurfaceBank
from omad.estimation.estimate import Estimate
from omad.estimation.estimator import Estimator
from omad.geometry.camera import STANDARD_CAMERA
from omad.model.checkpoint import find_weights, load
from omad.model.object_prior import object_keypoints
from omad.model.priornet import PriorNet
from omad.sensing.depth_files import read_depth
from omad.sensing.observation import Observation


@dataclass(frozen=True)
class Config:
    """Settings of the benchmark."""

    category: str = "dishwasher"
    objects: int = 4
    frames: int = 150
    gap: int = 20
    """Frames without the object, in the middle."""
    threads: int = 1
    seed: int = 3
    json: bool = False


@dataclass(frozen=True)
class Followed:
    """One sequence, tracked and frame by frame."""

    frames: list[SequenceFrame]
    tracked: list[TrackedEstimate]
    alone: list[Estimate | None]
    shape_errors: list[float]
    """Of the belief after each tracked frame."""
    shape_errors_alone: list[float]
    wall: list[float]
    cpu: list[float]
    wall_alone: list[float]
    cpu_alone: list[float]


def observe(path: Path) -> Observation | None:
    """None where the frame shows nothing."""
    try:
        return Observation.from_depth(read_depth(path), STANDARD_CAMERA)
    except NothingSeen:
        return None


def follow(estimator: Estimator, number: int, config: Config, folder: Path) -> Followed:
    """Render one object's sequence and run both."""
    category, prior = estimator.category, estimator.net.prior
    model = generate(category, number, "test", config.seed)
    net = load(PriorNet, find_weights(config.category) / "prior")
    middle = config.frames // 2
    settings = SequenceConfig(frames=config.frames, gap=(middle, middle + config.gap), seed=number)
    frames, paths = list(render_sequence(model, category, settings)), []
    for index, frame in enumerate(frames):
        paths.append(folder / f"{index:04d}.png")
        Image.fromarray(np.rint(frame.depth * 1000).astype(np.uint16)).save(paths[-1])
    with torch.no_grad():
        bank = SurfaceBank.from_models([model], category)
        true = prior.keypoints(net.prior.encode(object_keypoints(net, bank)))[0]

    def shape_error(beta: np.ndarray) -> float:
        made = prior.keypoints(torch.as_tensor(beta).to(true)[None])[0]
        return (made - true).square().sum(-1).mean().sqrt().item()

    tracker = Tracker(estimator)
    done = Followed(frames, [], [], [], [], [], [], [], [])
    with torch.no_grad():
        for path, frame in zip(paths, frames, strict=True):
            wall, cpu = time.perf_counter(), time.process_time()
            done.tracked.append(tracker(observe(path), frame.time))
            done.wall.append(time.perf_counter() - wall)
            done.cpu.append(time.process_time() - cpu)
            if done.tracked[-1].status == "tracking":
                done.shape_errors.append(shape_error(tracker.shape.mean))
            wall, cpu = time.perf_counter(), time.process_time()
            observation = observe(path)
            done.alone.append(None if observation is None else estimator(observation))
            done.wall_alone.append(time.perf_counter() - wall)
            done.cpu_alone.append(time.process_time() - cpu)
            if done.alone[-1] is not None:
                done.shape_errors_alone.append(shape_error(done.alone[-1].beta))
    return done


def rotation_error(estimate: Estimate, frame: SequenceFrame) -> float:
    """Degrees."""
    turn = estimate.T_camera_base[:3, :3] @ frame.T_camera_base[:3, :3].T
    return float(np.degrees(Rotation.from_matrix(turn).magnitude()))


def recovery(done: Followed, gap_end: int) -> float:
    """Seconds from the object's return to the first frame tracked."""
    back = [one.time for one in done.tracked[gap_end:] if one.status == "tracking"]
    return back[0] - done.frames[gap_end].time if back else float("inf")


def turned(estimator: Estimator, quarters: int, config: Config) -> float:
    """Seconds until a track that was turned about the vertical by quarters of a circle is right again."""
    model = generate(estimator.category, 0, "test", config.seed)
    tracker, when = Tracker(estimator), None
    for index, frame in enumerate(render_sequence(model, estimator.category, SequenceConfig(frames=60))):
        one = tracker(Observation.from_depth(frame.depth, STANDARD_CAMERA), frame.time)
        if when is None and index >= 15 and one.status == "tracking":
            motion = tracker._track.motion  # type: ignore[union-attr]
            pose = motion.placement.T_camera_base.copy()
            pose[:3, :3] = pose[:3, :3] @ Rotation.from_rotvec([0, quarters * np.pi / 2, 0]).as_matrix()
            motion.placement, when = Placement(pose, motion.placement.joint_states), frame.time
        elif (
            when is not None and one.status == "tracking" and one.estimate and rotation_error(one.estimate, frame) < 30
        ):
            return frame.time - when
    return float("inf")


def report(estimator: Estimator, runs: list[Followed], config: Config) -> dict[str, Any]:
    """All numbers of the sequences together."""
    category = estimator.category
    factor = [np.degrees(1) if turns else 100.0 for turns in category.turning]
    joints, end = [], config.frames // 2 + config.gap
    rows = [
        [
            (one.estimate, alone, frame)
            for one, alone, frame in zip(run.tracked, run.alone, run.frames, strict=True)
            if one.status == "tracking" and one.estimate is not None and alone is not None
        ]
        for run in runs
    ]
    for j, spec in enumerate(category.joints):
        kinds: dict[str, Any] = {"name": spec.name}
        for kind in (0, 1):
            found = [
                spread(factor[j] * np.array([row[:2][kind].joint_states[j] - row[2].states[j] for row in run]))
                for run in rows
            ]
            kinds[("tracked", "alone")[kind]] = {
                key: float(np.mean(np.array([f[key] for f in found], dtype=float))) for key in found[0]
            }
        kinds["tracked_over_alone"] = {key: kinds["tracked"][key] / kinds["alone"][key] for key in kinds["alone"]}
        joints.append(kinds)
    turns = {
        kind: [rotation_error(row[:2][i], row[2]) for run in rows for row in run]
        for i, kind in enumerate(("tracked", "alone"))
    }
    shapes = [run.shape_errors for run in runs]
    ages = [age for age in (1, 5, 15, 30, 60, 100) if age <= min(map(len, shapes))]

    def milliseconds(name: str) -> float:
        return 1000 * float(np.mean([seconds for run in runs for seconds in getattr(run, name)[5:]]))

    times = {name: milliseconds(name) for name in ("wall", "cpu", "wall_alone", "cpu_alone")}
    return {
        "category": category.name,
        "threads": config.threads,
        "sequences": len(runs),
        "joints": joints,
        "rotation_deg": {kind: float(np.mean(values)) for kind, values in turns.items()},
        "turned_over_45_deg": {kind: float(np.mean(np.array(values) > 45)) for kind, values in turns.items()},
        "tracked_share": float(np.mean([len(run) for run in rows])) / (config.frames - config.gap),
        "recovery_seconds": [round(recovery(run, end), 3) for run in runs],
        "righted_after_seconds": {f"{90 * q} deg": round(turned(estimator, q, config), 3) for q in (1, 2)},
        "shape_error_after_frames": {age: float(np.mean([s[age - 1] for s in shapes])) for age in ages},
        "shape_error_alone": float(np.mean([e for run in runs for e in run.shape_errors_alone])),
        "ms_per_frame": times,
        "frames_per_second": {name: 1000 / value for name, value in times.items()},
    }


def main(config: Config) -> None:
    keep_freed_memory()
    torch.set_num_threads(config.threads)
    estimator = Estimator.from_pretrained(config.category, device="cpu")
    runs = []
    for number in range(config.objects):
        with tempfile.TemporaryDirectory() as folder:
            runs.append(follow(estimator, number, config, Path(folder)))
    answer = report(estimator, runs, config)
    print(json.dumps(answer) if config.json else json.dumps(answer, indent=1))


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
