"""A depth file or a demo object, estimated for the explorer. Pure; it knows nothing of the page."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from ..errors import InputError
from ..estimate import Estimate
from ..estimator import Estimator
from ..inputs import InputReader
from ..observation import Observation
from ..sources.procedural import generate
from ..standard_views import standard_view

MAX_POINTS = 8_000
"""Of a cloud that are drawn."""


@dataclass(frozen=True)
class FitRequest:
    """A file to fit and how to read it: the options of ``omad estimate``."""

    file: Path
    intrinsics: str | None = None
    mask: Path | None = None
    box: str | None = None
    segment: Literal["plane"] | None = None
    depth_scale: float | None = None

    @classmethod
    def of_texts(cls, file: str, intrinsics: str, mask: str, box: str, on_plane: bool, depth_scale: str) -> FitRequest:
        """From what stands in text boxes; an empty one says nothing. Raises InputError."""
        if not file.strip():
            raise InputError("no file to fit; upload one or type the path of a depth image or a cloud")
        return cls(
            file=Path(file.strip()).expanduser(),
            intrinsics=intrinsics.strip() or None,
            mask=Path(mask.strip()).expanduser() if mask.strip() else None,
            box=box.strip() or None,
            segment="plane" if on_plane else None,
            depth_scale=_scale(depth_scale.strip()) if depth_scale.strip() else None,
        )


@dataclass(frozen=True)
class Fit:
    """What was seen and what is made of it, in the estimated base frame, where the explorer draws."""

    title: str
    estimate: Estimate
    cloud: np.ndarray
    """(N, 3) metres."""
    labels: np.ndarray
    """(N,) part of each point."""
    seen_keypoints: np.ndarray
    """(M, 3) where the network saw the keypoints: what the model was fitted to."""

    @classmethod
    def of(cls, title: str, observation: Observation, estimate: Estimate) -> Fit:
        """Carry an answer from the camera's frame to the base's."""
        count = len(observation.points)
        drawn = np.sort(np.random.default_rng(0).permutation(count)[:MAX_POINTS])
        T_base_camera = np.linalg.inv(estimate.T_camera_base)
        return cls(
            title=title,
            estimate=estimate,
            cloud=_carried(T_base_camera, observation.points[drawn]),
            labels=estimate.part_labels[drawn],
            seen_keypoints=_carried(T_base_camera, estimate.observed_keypoints),
        )


def fit_file(estimator: Estimator, request: FitRequest) -> Fit:
    """Read a file and estimate the object in it. Raises InputError with the file's name."""
    observation = InputReader.of(request, [request.file])(request.file)
    return Fit.of(request.file.name, observation, estimator(observation))


def fit_demo(estimator: Estimator, seed: int) -> Fit:
    """A procedural object that no training has seen, from a random view. Raises InputError without a generator."""
    category = estimator.category
    model = generate(category, seed, "test")
    view = standard_view(model, category, (seed, 1000))
    observation = Observation.from_depth(view.depth, view.camera)
    return Fit.of(model.name, observation, estimator(observation))


def describe_fit(fit: Fit) -> str:
    """What was found, as Markdown: a table of joints, how sure, warnings."""
    estimate = fit.estimate
    rows = ["| joint | state | ± | limits |", "|---|---|---|---|"]
    for joint in estimate.joints:
        per_unit, unit = (np.radians(1), "°") if joint.type == "revolute" else (0.01, " cm")
        low, high = (limit / per_unit for limit in joint.limits)
        state, std = joint.state / per_unit, joint.state_std / per_unit
        rows.append(f"| {joint.name} | {state:.1f}{unit} | {std:.1f}{unit} | {low:.0f} to {high:.0f}{unit} |")
    milliseconds = 1000 * sum(estimate.seconds.values())
    said = f"{len(estimate.part_labels)} points, residual {1000 * estimate.residual:.1f} mm, {milliseconds:.0f} ms"
    doubts = [*estimate.warnings, *([] if estimate.converged else ["the fit did not converge"])]
    warned = [f"⚠️ {doubt}" for doubt in doubts]
    return "\n\n".join([f"**Found in** `{fit.title.replace('`', '')}`", "\n".join(rows), said, *warned])


def _scale(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not 0 < value < float("inf"):
        raise InputError(f"depth scale {text}: must be a number above 0, in metres per stored number")
    return value


def _carried(transform: np.ndarray, points: np.ndarray) -> np.ndarray:
    return points @ transform[:3, :3].T + transform[:3, 3]
