"""A depth file or a demo object, estimated for the explorer. Pure; it knows nothing of the page."""

from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

import numpy as np

from omad.common.errors import InputError, as_line, shown
from omad.data.procedural import GENERATORS, generate
from omad.data.rendering.standard_views import standard_view
from omad.estimation.estimate import Estimate
from omad.estimation.estimator import Estimator
from omad.geometry.rigid import carry
from omad.output.picture import reading
from omad.sensing.camera_files import is_numbers
from omad.sensing.input_options import InputOptions
from omad.sensing.observation import Observation
from omad.sensing.reader import InputReader

from .places import Places

MARKUP = {*"&<>|`[]!*_\\~#"}
"""What Markdown reads otherwise than letter by letter."""
MAX_POINTS = 8_000
"""Of a cloud that are drawn."""


@dataclass(frozen=True)
class FitRequest:
    """A file to fit and how to read it."""

    file: Path
    options: InputOptions = InputOptions()

    @classmethod
    def of_texts(
        cls, file: str, intrinsics: str, mask: str, box: str, on_plane: bool, depth_scale: str, places: Places
    ) -> Self:
        """From what stands in text boxes; an empty one says nothing. Raises InputError, also for files that are not in
        one of the ``places``."""
        file, intrinsics, mask, box, scale = (text.strip() for text in (file, intrinsics, mask, box, depth_scale))
        if not file:
            raise InputError("no file to fit; upload one or type the path of a depth image or a cloud")
        if intrinsics and not is_numbers(intrinsics):
            intrinsics = str(places.checked(intrinsics))
        options = InputOptions(intrinsics=intrinsics or None, box=box or None, segment="plane" if on_plane else None)
        found = {"mask": places.checked(mask) if mask else None, "depth_scale": _scale(scale) if scale else None}
        return cls(places.checked(file), replace(options, **found))


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
    def of(cls, title: str, observation: Observation, estimate: Estimate) -> Self:
        """Carry an answer from the camera's frame to the base's."""
        drawn = np.sort(np.random.default_rng(0).permutation(len(observation.points))[:MAX_POINTS])
        T_base_camera = np.linalg.inv(estimate.T_camera_base)
        cloud, keypoints = (carry(T_base_camera, p) for p in (observation.points[drawn], estimate.observed_keypoints))
        return cls(title, estimate, cloud, estimate.part_labels[drawn], keypoints)


def fit_file(estimator: Estimator, request: FitRequest) -> Fit:
    """Read a file and estimate the object in it. Raises InputError with the file's name."""
    observation = InputReader.of(request.options, [request.file])(request.file)
    return Fit.of(request.file.name, observation, estimator(observation))


def fit_demo(estimator: Estimator, seed: int) -> Fit:
    """A procedural object that no training has seen, from a random view. Raises InputError without a generator."""
    name = estimator.category.name
    if name not in GENERATORS:
        raise InputError(f"no unseen object to show: the package makes none of {name}; give a file to fit")
    model = generate(estimator.category, seed, "test")
    observation = standard_view(model, estimator.category, (seed, 1000)).observation()
    return Fit.of(model.name, observation, estimator(observation))


def describe_fit(fit: Fit) -> str:
    """What was found, as Markdown: a table of joints, how sure, warnings."""
    estimate = fit.estimate
    rows = ["| joint | state | ± | limits |", "|---|---|---|---|"]
    for joint in estimate.joints:
        per_unit, unit = reading(joint.pivot is not None)
        low, high = (limit / per_unit for limit in joint.limits)
        state, std = joint.state / per_unit, joint.state_std / per_unit
        rows.append(f"| {_literal(joint.name)} | {state:.1f}{unit} | {std:.1f}{unit} | {low:.0f} to {high:.0f}{unit} |")
    milliseconds = 1000 * sum(estimate.seconds.values())
    said = f"{len(estimate.part_labels)} points, residual {1000 * estimate.residual:.1f} mm, {milliseconds:.0f} ms"
    doubts = [*estimate.warnings] + ["the fit did not converge"] * (not estimate.converged)
    doubts += ["doubtful: rather wrong than right"] * bool(estimate.doubtful)
    found = [f"**Found in** `{as_line(fit.title.replace('`', ''))}`", "\n".join(rows), said]
    return "\n\n".join(found + [f"⚠️ {_literal(doubt)}" for doubt in doubts])


def _literal(text: str) -> str:
    """As Markdown shows it letter by letter: it would run what names of strangers' files hold."""
    return "".join(f"&#{ord(letter)};" if letter in MARKUP else letter for letter in as_line(text))


def _scale(text: str) -> float:
    with suppress(ValueError):
        if 0 < float(text) < float("inf"):
            return float(text)
    raise InputError(f"depth scale {shown(text)}: must be a number above 0, in metres per stored number")
