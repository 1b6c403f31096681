"""Shape, pose, joint states and joint axes of one articulated object, from the points of one depth view.

This file lies in a folder with four others, ONNX graphs and a table of numbers; it needs NumPy and ONNX Runtime:

    python estimate.py points.npy
    python estimate.py depth.npy --intrinsics 600,600,319.5,239.5 --mask mask.npy

    from estimate import Program
    answer = Program()(points)              # (N, 3) metres, camera frame: x right, y down, z forward

As ``omad.Estimator``: a look in camera axes, a fit, a look in the frame found, a fit; without what is not the object,
and once more in turned frames where it is unsure. Metres and radians.
"""

import argparse
import json
import math
import sys
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime

from omad.applications.deployment.choice import choose_points
from omad.applications.deployment.given import read_points
from omad.estimation.looks.relief import as_shut, relief
from omad.model.fronts.image import front_image

FAR, CENTIMETRES = 100.0, 250.0
"""A median distance above the first is in millimetres, or below the second in centimetres."""
FARTHEST = 1e4
"""Nothing is measured farther away: such numbers mean no measurement."""
MIRROR = np.array([-1.0, 1.0, 1.0])
HALF_TURNS = [np.diag([*signs, 1.0]) for signs in ((1, -1, -1), (-1, 1, -1), (-1, -1, 1))]


@dataclass(frozen=True)
class Answer:
    """About one object; keypoints, axes, pivots and parts in the camera frame."""

    beta: np.ndarray
    """(D,) shape parameters."""
    joint_states: np.ndarray
    """(J,) radians or metres."""
    state_std: np.ndarray
    """(J,) standard deviations by least squares."""
    axes: np.ndarray
    """(J, 3) unit."""
    pivots: np.ndarray
    """(J, 3)."""
    T_camera_part: np.ndarray
    """(J + 1, 4, 4); the first is the base."""
    keypoints: np.ndarray
    """(M, 3)."""
    keypoint_std: np.ndarray
    """(M,) expected errors of the keypoints that the fit was given."""
    residual: float
    """RMS distance of keypoints from where they were seen."""
    converged: bool
    hand: float
    """Of a category whose objects may be of either hand, the larger the likelier it is of that hand."""
    of_other_hand: bool = False
    """Whether the object is the mirror image of one of the category."""

    def mirrored(self, turning: np.ndarray) -> "Answer":
        """Its image in the plane x = 0; ``beta`` stays that of the object in the mirror."""
        flip = np.diag([*MIRROR, 1.0])
        axes = np.where(turning[:, None], -self.axes * MIRROR, self.axes * MIRROR)
        placed = {"pivots": self.pivots * MIRROR, "keypoints": self.keypoints * MIRROR}
        return replace(self, axes=axes, T_camera_part=flip @ self.T_camera_part @ flip, of_other_hand=True, **placed)


@dataclass(frozen=True)
class Look:
    """What the network says of one cloud, in the camera frame and category units."""

    keypoints: np.ndarray
    """(M, 3)."""
    weights: np.ndarray
    """(M,) 1 / sigma^2."""
    row: np.ndarray
    """(16 + J + D) its own state: base pose row by row, joint states, beta."""
    pooled: np.ndarray
    """(P,) what it knows of the whole cloud."""
    logits: np.ndarray
    """(n, K) of the points shown."""

    @property
    def expected_error(self) -> float:
        """Of keypoints, geometric mean."""
        return float(np.exp(-0.5 * np.log(self.weights).mean()))


@dataclass(frozen=True)
class Fit:
    """What the refinement found."""

    row: np.ndarray
    covariance: np.ndarray
    """(P, P) of rotation, translation, joint states, beta."""
    converged: bool
    residual: float

    @property
    def frame(self) -> np.ndarray:
        """T_camera_base."""
        return self.row[:16].reshape(4, 4)


class Program:
    """An estimator of one category, from the files beside this one."""

    def __init__(self, folder: str | Path = Path(__file__).parent, threads: int = 1) -> None:
        folder, options = Path(folder), onnxruntime.SessionOptions()
        options.intra_op_num_threads = threads
        self.numbers: dict[str, Any] = json.loads((folder / "estimator.json").read_text())
        graphs: list[Any] = [
            onnxruntime.InferenceSession(str(folder / name), options, providers=["CPUExecutionProvider"])
            for name in ("network.onnx", "energy.onnx", "hand.onnx")
            if (folder / name).exists()
        ]
        self._network, self._energy, *hand = graphs
        self._hand = hand[0] if hand else None
        self._joints, self._turning = len(self.numbers["joints"]), np.array(self.numbers["turning"], bool)
        self._beta_mean, self._whitening = (np.array(self.numbers[name]) for name in ("beta_mean", "whitening"))
        self._limits = np.array(self.numbers["limits"]).reshape(-1, 2)

    def __call__(self, points: np.ndarray) -> Answer:
        """Of points (N, 3); rows that are not finite, all zero or beyond ``FARTHEST`` are no measurement. Raises
        ValueError for another shape, too few points, millimetres, and for what lies behind the camera."""
        points = np.asarray(points, np.float32)
        if points.ndim != 2 or points.shape[1] != 3:
            raise ValueError("points: give numbers of shape (N, 3), metres")
        points = points[np.isfinite(points).all(1) & points.any(1)]
        away = np.abs(points).max(1)
        if len(away) and (median := float(np.median(away))) > FAR:
            unit, scale = ("centimetres", 0.01) if median < CENTIMETRES else ("millimetres", 0.001)
            raise ValueError(f"points: median distance {median:.0f} looks like {unit}; multiply by {scale}")
        points = points[away < FARTHEST]
        if len(points) < self.numbers["least_points"]:
            raise ValueError(f"points: {len(points)} are too few, at least {self.numbers['least_points']} are needed")
        if np.count_nonzero(points[:, 2] <= 0) > len(points) / 2:
            raise ValueError("points: most of them lie behind the camera; turn z forward")
        plain = self._answer(points)
        if not self.numbers["either_hand"]:
            return plain
        image = self._answer(points * MIRROR.astype(np.float32)).mirrored(self._turning)
        return max(plain, image, key=lambda answer: answer.hand)

    def _answer(self, points: np.ndarray) -> Answer:
        numbers, samples = self.numbers, self.numbers["samples"]
        clouds = self._shown(points)
        frame = first_frame(clouds, numbers["far"])
        look, crowd = self._look(clouds[: samples[0]], frame), None
        if numbers["tells_outside"] and self._crowded(look.logits):
            kept = self._on_object(points, self._look(clouds, frame).logits)
            if len(kept) >= max(numbers["least_points"], numbers["left"] * len(points)):
                cleaned = self._shown(points[kept])
                again = self._look(cleaned[: samples[0]], first_frame(cleaned, numbers["far"]))
                if again.expected_error < look.expected_error:
                    crowd, clouds, look = (clouds, look), cleaned, again
        fit, first = self._refine(look, None), samples[0]
        for count in samples[1:]:
            look = self._look(clouds[first : first + count], fit.frame)
            fit, first = self._refine(look, fit.row), first + count
        last = samples[-1]
        if crowd is not None and len(samples) > 1:
            start = self._refine(crowd[1], None)
            again = self._look(crowd[0][-last:], start.frame)
            if again.expected_error < look.expected_error:
                clouds, look, fit = crowd[0], again, self._refine(again, start.row)
        if look.expected_error > numbers["unsure"]:
            look, fit = self._turned(clouds, look, fit)
        if numbers["own_states"]:
            fit = self._leaning(fit, look)
        return self._told(fit, look, points)

    def _turned(self, clouds: np.ndarray, look: Look, fit: Fit) -> tuple[Look, Fit]:
        """The surest of the answers that begin in frames turned by half, if it is much surer than that given."""
        samples, found = self.numbers["samples"], []
        for turn in HALF_TURNS:
            start = self._refine(self._look(clouds[: samples[0]], fit.frame @ turn), None)
            again = self._look(clouds[-samples[-1] :], start.frame)
            turned = self._refine(again, start.row)
            inverted = fit.frame[1, 1] < 0 <= turned.frame[1, 1]
            found.append((again.expected_error / self.numbers["surer"][int(inverted)], again, turned))
        missed, again, turned = min(found, key=lambda each: each[0])
        return (again, turned) if missed < look.expected_error else (look, fit)

    def _shown(self, points: np.ndarray) -> np.ndarray:
        """(samples, n, 3) random choices, category units."""
        numbers = self.numbers
        chosen = choose_points(points, numbers["points"], sum(numbers["samples"]), numbers["seed"], numbers["cells"])
        return (points[chosen] / numbers["metres_per_unit"]).astype(np.float32)

    def _look(self, clouds: np.ndarray, frame: np.ndarray) -> Look:
        """At random choices (samples, n, 3) of a cloud, in a frame (4, 4)."""
        frame = frame.astype(np.float32)
        said = self._network.run(None, {"input": (clouds - frame[:3, 3]) @ frame[:3, :3]})
        beta, base, states, keypoints, log_sigma, pooled, logits = map(np.asarray, said)
        precision = np.exp(-2 * log_sigma)
        total = precision.sum(0)
        mean = (precision[..., None] * keypoints).sum(0) / total[:, None]
        row = np.concatenate([(frame @ base[0]).ravel(), states.mean(0), beta.mean(0)]).astype(np.float64)
        seen = (mean @ frame[:3, :3].T + frame[:3, 3]).astype(np.float64)
        weights = (total / len(clouds)).astype(np.float64)
        return Look(seen, weights, row, pooled.mean(0), logits.reshape(-1, logits.shape[-1]))

    def _crowded(self, logits: np.ndarray) -> bool:
        return bool((logits[:, -1] - logits[:, :-1].max(1) > self.numbers["sure"]).mean() > self.numbers["few"])

    def _on_object(self, points: np.ndarray, logits: np.ndarray) -> np.ndarray:
        """Which points are: those whose nearest neighbour among the labelled is."""
        numbers = self.numbers
        chosen = choose_points(points, numbers["points"], sum(numbers["samples"]), numbers["seed"], numbers["cells"])
        chosen, first = np.unique(chosen, return_index=True)  # what was said of a point first counts
        seen, outside = points[chosen].astype(np.float64), logits[first].argmax(1) == logits.shape[1] - 1
        kept = []
        for start in range(0, len(points), 1024):
            apart = np.square(seen).sum(1) - 2 * points[start : start + 1024].astype(np.float64) @ seen.T
            kept.append(~outside[apart.argmin(1)])
        return np.flatnonzero(np.concatenate(kept))

    def _at(self, row: np.ndarray) -> list[np.ndarray]:
        return [np.asarray(found)[0] for found in self._energy.run(None, {"input": row[None]})]

    def _refine(self, look: Look, row: np.ndarray | None) -> Fit:
        """Levenberg-Marquardt on the energy, from ``row`` or from the look's own state with a fitted base."""
        if row is None:
            row = np.append(np.eye(4), look.row[16:])
            row[:16] = fit_transform(self._at(row)[0], look.keypoints, look.weights).ravel()
        trust, end = self.numbers["trust_region"], self.numbers["termination"]
        cost, gradient, hessian, residual = self._energy_at(row, look)
        damping, growth, converged, steps = trust["initial_damping"], 2.0, False, 0
        while steps < end["max_iterations"] and damping <= trust["max_damping"] and not converged:
            steps += 1
            diagonal = hessian.diagonal()
            scale = np.maximum(diagonal, trust["diagonal_floor"] * diagonal.max())
            extra = damping * np.where(scale > 0, scale, 1.0)
            step = -np.linalg.solve(hessian + np.diag(extra), gradient)
            trial = self._moved(row, step)
            found = self._energy_at(trial, look)
            gained, promised = cost - found[0], float(step @ (extra * step - gradient))
            longest = float(np.abs(step).max())
            if gained > 0:
                converged = longest < end["step_tolerance"] or gained < end["cost_tolerance"] * cost
                damping *= max(1 - (2 * gained / promised - 1) ** 3, 1 / 3)
                growth, row, (cost, gradient, hessian, residual) = 2.0, trial, found
            else:  # rounding may hide the last decrease
                tiny = promised <= 8 * np.finfo(float).eps * cost
                converged = tiny or (longest < end["step_tolerance"] and damping <= 1)
                damping, growth = damping * growth, 2 * growth
        unit = np.sqrt(np.where(hessian.diagonal() > 0, hessian.diagonal(), 1e-12))
        inverse = np.linalg.inv(hessian / np.outer(unit, unit) + 1e-12 * np.eye(len(unit)))
        return Fit(row, inverse / np.outer(unit, unit), converged, residual)

    def _energy_at(self, row: np.ndarray, look: Look) -> tuple[float, np.ndarray, np.ndarray, float]:
        """Energy, J^T r, J^T J, and RMS distance of keypoints."""
        points, jacobian = self._at(row)[:2]
        J, huber = self._joints, self.numbers["huber"] or math.inf
        squared = np.square(points - look.keypoints).sum(1)
        length = np.sqrt(look.weights * squared)
        root = np.sqrt(look.weights * np.where(length > huber, huber / np.maximum(length, huber), 1.0))
        states, white = row[16 : 16 + J], self._whitening @ (row[16 + J :] - self._beta_mean)
        outside = np.maximum(states - self._limits[:, 1], 0) + np.minimum(states - self._limits[:, 0], 0)
        limits = np.diag(outside != 0) / self.numbers["limit_sigma"]
        by_unknowns = np.zeros((3 * len(points) + len(white) + J, jacobian.shape[-1]))
        by_unknowns[: 3 * len(points)] = (root[:, None, None] * jacobian).reshape(3 * len(points), -1)
        by_unknowns[3 * len(points) : -J, 6 + J :] = self._whitening
        by_unknowns[-J:, 6 : 6 + J] = limits
        off = (root[:, None] * (points - look.keypoints)).ravel()
        residuals = np.concatenate([off, white, outside / self.numbers["limit_sigma"]])
        robust = np.where(length > huber, huber * (2 * length - huber), length**2) if huber < math.inf else length**2
        cost = float(robust.sum() + white @ white + np.square(residuals[-J:]).sum())
        return cost, by_unknowns.T @ residuals, by_unknowns.T @ by_unknowns, float(np.sqrt(squared.mean()))

    def _moved(self, row: np.ndarray, step: np.ndarray) -> np.ndarray:
        """After a tangent step (P,)."""
        moved = row.copy()
        pose = moved[:16].reshape(4, 4)
        pose[:3, :3] = rotation(step[:3]) @ pose[:3, :3]
        pose[:3, 3] += step[3:6]
        moved[16:] += step[6:]
        return moved

    def _leaning(self, fit: Fit, look: Look) -> Fit:
        """With a share of the network's own joint states; the rest follows as the covariance has it go along."""
        joints = slice(6, 6 + self._joints)
        wanted = self.numbers["own_states"] * (look.row[16 : 16 + self._joints] - fit.row[16 : 16 + self._joints])
        gain = fit.covariance[:, joints] @ np.linalg.inv(fit.covariance[joints, joints])
        row = self._moved(fit.row, gain @ wanted)
        apart = np.square(self._at(row)[0] - look.keypoints).sum(1)
        return replace(fit, row=row, residual=float(np.sqrt(apart.mean())))

    def _told(self, fit: Fit, look: Look, points: np.ndarray) -> Answer:
        numbers, J, whose = self.numbers, self._joints, self.numbers["part_of_keypoint"]
        unit, units, hand = numbers["metres_per_unit"], np.array(numbers["state_units"]), np.array(numbers["hand"])
        keypoints, _, _, axes, pivots, parts = self._at(fit.row)
        parts, keypoints, pivots = parts.copy(), keypoints * unit, pivots * unit
        parts[:, :3, 3] *= unit
        told, front = np.append(look.pooled, -parts[0, 1, 1]), self._front(points, keypoints, parts[0])
        if len(hand) and self._turning[0]:
            told = as_shut(told, front, fit.row[16], relief(points, keypoints, whose, parts, axes[0], pivots[0], unit))
        else:
            told = np.append(told, [front, 0.0])
        return Answer(
            beta=fit.row[16 + J :],
            joint_states=fit.row[16 : 16 + J] * units,
            state_std=np.sqrt(fit.covariance.diagonal()[6 : 6 + J].clip(0)) * units,
            axes=axes,
            pivots=pivots,
            T_camera_part=parts,
            keypoints=keypoints,
            keypoint_std=unit / np.sqrt(look.weights),
            residual=fit.residual * unit,
            converged=bool(fit.converged),
            hand=_odds(hand, told) if len(hand) else -float(np.log(look.expected_error)),
        )

    def _front(self, points: np.ndarray, keypoints: np.ndarray, place: np.ndarray) -> float:
        """What tells the hand by the front of an object at ``place`` (4, 4)."""
        if self._hand is None:
            return 0.0
        body = (keypoints[np.array(self.numbers["part_of_keypoint"]) == 0] - place[:3, 3]) @ place[:3, :3]
        image = front_image(points, place, np.stack([body.min(0), body.max(0)]))
        return float(self._hand.run(None, {"input": image[None]})[0][0])


def _odds(hand: np.ndarray, told: np.ndarray) -> float:
    """By a linear function, its constant last, of the first numbers of ``told``."""
    return float(told[: len(hand) - 1] @ hand[:-1] + hand[-1])


def first_frame(clouds: np.ndarray, far: float) -> np.ndarray:
    """T_camera_input (4, 4): camera axes at the mean of the points not ``far`` from their median, or of all of them."""
    points = clouds.reshape(-1, 3)
    median = np.sort(points, axis=0)[(len(points) - 1) // 2]
    near = np.square(points - median).sum(1) <= far**2
    frame = np.eye(4)
    frame[:3, 3] = points[near | (not near.any())].mean(0, dtype=np.float64)
    return frame


def fit_transform(a: np.ndarray, b: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """The rigid T (4, 4) that brings points ``a`` (N, 3) nearest to ``b``: weighted least squares (Kabsch 1976)."""
    share = (weights / weights.sum())[:, None]
    mean_a, mean_b = (share * a).sum(0), (share * b).sum(0)
    U, _, V = np.linalg.svd((share * (b - mean_b)).T @ (a - mean_a))
    T = np.eye(4)
    T[:3, :3] = U * [1.0, 1.0, np.linalg.det(U @ V)] @ V
    T[:3, 3] = mean_b - T[:3, :3] @ mean_a
    return T


def rotation(v: np.ndarray) -> np.ndarray:
    """exp of a rotation vector (3,)."""
    angle = float(np.linalg.norm(v))
    s, k = (1.0, 0.5) if angle < 1e-7 else (math.sin(angle) / angle, (1 - math.cos(angle)) / angle**2)
    skew = np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
    return np.eye(3) + s * skew + k * skew @ skew


def main() -> int:
    """Print the answer as JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("input", help=".npy: points (N, 3) or a depth image (H, W), metres")
    parser.add_argument("--intrinsics", help="fx,fy,cx,cy of a depth image, pixels")
    parser.add_argument("--mask", help=".npy: (H, W), not zero on the object, or probabilities")
    options = parser.parse_args()
    try:
        points = read_points(options.input, options.intrinsics, options.mask)
        answer = asdict((program := Program())(points))
    except (OSError, ValueError) as error:
        print(f"{options.input}: {error}", file=sys.stderr)
        return 2
    record = {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in answer.items()}
    print(json.dumps({"category": program.numbers["category"], "joints": program.numbers["joints"], **record}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
