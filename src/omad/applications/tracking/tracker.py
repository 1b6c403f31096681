"""Follow one object through a sequence of frames.

    tracker = omad.Tracker(omad.Estimator.from_pretrained("dishwasher"))
    for observation, time in frames:
        tracked = tracker(observation, time)      # .status .estimate .single

While the object is followed, a frame costs one look of the network, in the frame where the object is expected; least
squares start there, with the shape believed so far as their prior. A Kalman filter smooths pose and joint states. At
intervals, and wherever a frame surprises, a cold start challenges the track. An object that is lost is searched with
cold starts until two consecutive ones agree; at first one that is surely right will do.
"""

from dataclasses import dataclass, replace
from numbers import Real
from typing import Any, Literal, Self

import numpy as np
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from omad.common.arrays import as_doubles
from omad.common.errors import InputError, shown
from omad.estimation.categories.late import AnyEstimator
from omad.estimation.checks import Check, depth_doubts, no_surer, warned
from omad.estimation.confidence.model import right_within
from omad.estimation.estimate import Estimate
from omad.estimation.known import NOTHING_KNOWN, Known, Near, check_known
from omad.estimation.looks.shown import check_observations
from omad.geometry.rigid import diagonal
from omad.sensing.observation import Observation

from .motion import MotionConfig, MotionFilter, Placement
from .shape_belief import ShapeBelief, ShapeConfig

Status = Literal["lost", "tracking", "coasting"]


LATEST = 1e11
"""Seconds."""


@dataclass(frozen=True)
class TrackerConfig:
    """When frames are believed, and how they are smoothed."""

    motion: MotionConfig = MotionConfig()
    """How poses and joint states may change."""
    shape: ShapeConfig = ShapeConfig()
    """How the belief about the shape grows."""
    jitter: float = 0.4
    """Share of an answer's variance that differs from frame to frame. Filtering lowers this share; the rest, the
    error that neighbouring frames have in common, stays in the reported covariance."""
    gate: float = 1e-4
    """A frame whose innovation would be exceeded by chance with less than this probability is not believed."""
    lost_after: float = 0.6
    """Seconds without a believed frame until the object counts as lost."""
    challenge_every: int = 15
    """Frames between cold starts while all is well; 0: never. Those of a new track come sooner: each waits for twice
    as many frames as the one before."""
    switch: float = 1.5
    """Nats per keypoint by which the cold starts' evidence must be better, summed over frames, to replace the track."""
    worst_std: float = 0.12
    """Expected keypoint error (geometric mean, category units) above which a frame shows no such object ..."""
    likely: float = 0.7
    """... unless its answer is right with this probability: shut chests have hardly anything for keypoints to lie on.
    Of 480 noisy views of twelve categories, half of them shut, 52 right answers expect larger errors; 15 of these are
    so probable, and none of 23 wrong ones."""
    worst_residual: float = 0.12
    """Distance between model and observed keypoints (category units) above which it shows none, however probable."""
    sure: float = 0.9
    """Probability from which on the first answer of all starts a track, without another that agrees."""
    same_turn: float = float(np.radians(25))
    """Two answers agree where they differ by no more than this rotation (radians) ..."""
    same_place: float = 0.25
    """... and by no more than this RMS keypoint distance (category units)."""

    def __post_init__(self) -> None:
        if not 0 < self.gate < 1:
            raise InputError(f"TrackerConfig: gate is a share of one, above 0 and below 1, got {self.gate}")
        if not 0 <= self.jitter <= 1:
            raise InputError(f"TrackerConfig: jitter is a share of one, from 0 to 1, got {self.jitter}")
        if not self.motion.decay > 0:
            raise InputError(f"TrackerConfig: motion.decay is above 0, got {self.motion.decay}")


@dataclass(frozen=True)
class TrackedEstimate:
    """What is known of the object at one frame."""

    time: float
    """Seconds."""
    status: Status
    """coasting: followed, but this frame did not show it or was not believed; the prediction is given."""
    estimate: Estimate | None
    """The smoothed answer with its covariance, as an ``Estimate``; None while the object is lost."""
    single: Estimate | None = None
    """What this frame alone says; None where it shows nothing."""
    surprise: float | None = None
    """Squared Mahalanobis distance of this frame from its prediction."""
    restarted: bool = False
    """A new track begins here: the object was found, or a cold start was better."""

    def to_dict(self) -> dict[str, Any]:
        """Plain Python values: the ``estimate`` of ``Estimate.to_dict`` (null while lost) and each frame's own."""
        found = self.estimate.to_dict() if self.estimate else {}
        kept = "joints T_camera_base base_std beta mirrored hand_probability keypoints residual"
        kept += " probability doubtful warnings"
        own = {name: getattr(self, name) for name in ("time", "status", "restarted", "surprise")}
        single = self.single.joint_states.tolist() if self.single else None
        return own | {key: found.get(key) for key in kept.split()} | {"single_joint_states": single}


@dataclass(frozen=True, slots=True, eq=False)
class TrackedStates:
    """What a ``TrackedEstimate`` tells of the joints, without all else: hours of frames are kept."""

    time: float
    status: Status
    restarted: bool
    probability: float | None
    """Of the smoothed answer ..."""
    doubtful: bool
    told: np.ndarray
    """(3, J) radians or metres: its states, their standard deviations, and what the frame alone says; NaN where there
    is no answer."""

    @classmethod
    def of(cls, tracked: TrackedEstimate, joints: int) -> Self:
        """``joints``: how many its category has."""
        found, told = tracked.estimate, np.full((3, joints), np.nan)
        if found is not None:
            told[:2] = np.transpose([(joint.state, joint.state_std) for joint in found.joints])
        if tracked.single is not None:
            told[2] = tracked.single.joint_states
        sure, doubtful = (None, False) if found is None else (found.probability, bool(found.doubtful))
        return cls(tracked.time, tracked.status, tracked.restarted, sure, doubtful, told)


DEFAULT_CONFIG = TrackerConfig()


@dataclass
class _Track:
    """What is carried from frame to frame."""

    motion: MotionFilter
    last: Estimate
    """The last answer believed."""
    believed: float
    """Its time."""
    now: float
    common: np.ndarray
    """(N, N) covariance that the last believed answer shares with its neighbours."""
    last_view: Placement
    """Where it was when a frame last told of its shape."""
    doubt: float = 0.0
    """Evidence for the cold starts and against this track, nats per keypoint."""
    since_challenge: int = 0
    patience: int = 1
    """Frames from the last challenge to the next."""


class Tracker:
    """Gives a ``TrackedEstimate`` for each frame of one object."""

    def __init__(self, estimator: AnyEstimator, config: TrackerConfig = DEFAULT_CONFIG) -> None:
        self.estimator, self.config = estimator, config
        self._unit = estimator.category.metres_per_unit
        self._size = 6 + len(estimator.category.joints)
        self._limit = float(chi2.isf(config.gate, self._size))
        self._track: _Track | None = None
        self._candidate: Estimate | None = None
        """The last answer that no track believed: a second one that agrees with it starts a track."""
        self._doubts: list[Check] = []
        """Of whether images hold depth, as the last cold start found."""
        self._time = -np.inf
        self.shape = self._category_shape()

    def __call__(self, observation: Observation | None, time: float, known: Known = NOTHING_KNOWN) -> TrackedEstimate:
        """The next frame at ``time`` in seconds; None where it shows nothing. ``known``: of the object in this frame's
        camera, gravity say. Raises InputError for a time that does not come after the last one."""
        if not isinstance(time, Real) or not abs(time) < LATEST:
            raise InputError(f"time {shown(repr(time))}: must be seconds")
        time = float(time)
        if not time > self._time:
            raise InputError(f"time {time} s: must come after the last frame's, {self._time} s; sort the frames")
        if observation is not None:
            check_observations([observation])
        check_known(known, self.estimator.category, self.estimator.net.prior.basis_size)
        self._time = time
        track = self._track
        if track is None:
            return self._search(observation, time, known)
        track.motion.predict(time - track.now)
        track.now = time
        if observation is None:
            return self._miss(track, None, None)
        known, cold = _of_one_hand(known, track.last), None
        single = self._judged(self.estimator.near(observation, self._near(track), known), observation)
        if time - track.believed > self.config.lost_after:  # unseen for so long, it may be anywhere
            cold = self._cold(observation, known)
            single = max(single, cold, key=evidence)
        surprise = self._surprise(track, single)
        believed = surprise < self._limit and self._plausible(single)
        track.since_challenge += 1
        due = min(track.patience, self.config.challenge_every)
        if not believed or track.doubt > 0 or track.since_challenge == due:
            track.since_challenge, track.patience = 0, 2 * due
            cold = cold or self._cold(observation, known)
            single, believed = self._challenge(track, single, cold, believed)
            surprise = self._surprise(track, single)
        if believed:
            return self._believe(track, single, surprise, single is cold)
        plausible = self._plausible(single)
        if plausible and self._candidate is not None and self._agree(self._candidate, single):
            return self._start(single, time)
        self._candidate = single if plausible else None
        return self._miss(track, single, surprise)

    def _search(self, observation: Observation | None, time: float, known: Known) -> TrackedEstimate:
        before, self._candidate = self._candidate, None
        cold = None if observation is None else self._cold(observation, _of_one_hand(known, before))
        if cold is not None and self._plausible(cold):
            first_of_all = before is None and self.shape.views == 0 and (cold.probability or 0.0) >= self.config.sure
            if first_of_all or (before is not None and self._agree(before, cold)):
                return self._start(cold, time)
            self._candidate = cold
        return TrackedEstimate(time, "lost", None, cold)

    def _cold(self, observation: Observation, known: Known) -> Estimate:
        self._doubts = [*depth_doubts(observation)]
        return self._judged(self.estimator(observation, known), observation)

    def _judged(self, single: Estimate, observation: Observation) -> Estimate:
        return warned(no_surer(single, observation.likelihood), self._doubts)

    def _start(self, single: Estimate, time: float) -> TrackedEstimate:
        """Begin a track at an answer. The shape believed so far is kept where it may be the same object's."""
        n, config = self._size, self.config
        step, spread = single.beta - self.shape.mean, single.covariance[n:, n:] + self.shape.covariance
        if self.shape.views and step @ np.linalg.solve(spread, step) > chi2.isf(config.gate, len(step)):
            self.shape = self._category_shape()
        if not self.shape.views:
            self.shape.update(single.beta, single.covariance[n:, n:], self.shape.count(0.0))
        covariance, turning = single.covariance[:n, :n], self.estimator.category.turning
        limits = [joint.limits for joint in single.joints]
        motion = MotionFilter(config.motion, turning, Placement.of(single), config.jitter * covariance, limits)
        self._candidate = None
        common = (1 - config.jitter) * covariance
        self._track = _Track(motion, single, time, time, common, Placement.of(single))
        return TrackedEstimate(time, "tracking", self._answer(self._track), single, None, restarted=True)

    def _believe(self, track: _Track, single: Estimate, surprise: float, cold: bool) -> TrackedEstimate:
        n, jitter = self._size, self.config.jitter
        covariance = single.covariance[:n, :n]
        track.motion.update(Placement.of(single), jitter * covariance)
        track.last, track.believed, track.common = single, track.now, (1 - jitter) * covariance
        self._candidate, here = None, track.motion.placement
        # for the shape a frame counts by how far the view has moved since the last one that did
        step = track.last_view.step_to(here)
        lengths = np.where(self.estimator.category.turning, 1, 1 / self._unit)
        share = self.shape.count(float(np.linalg.norm(step[:3]) + np.linalg.norm(step[6:] * lengths)))
        track.last_view = here
        self.shape.update(single.beta, single.covariance[n:, n:], share, cold)
        return TrackedEstimate(track.now, "tracking", self._answer(track), single, surprise)

    def _miss(self, track: _Track, single: Estimate | None, surprise: float | None) -> TrackedEstimate:
        if track.now - track.believed > self.config.lost_after:
            self._track = None
            return TrackedEstimate(track.now, "lost", None, single, surprise)
        answer, said = self._answer(track).without_labels(), ("predicted: this frame was not used",)
        told = answer.probability
        unseen = replace(answer, warnings=said, probability=None if told is None else told * _still_right(answer))
        return TrackedEstimate(track.now, "coasting", unseen, single, surprise)

    def _challenge(self, track: _Track, warm: Estimate, cold: Estimate, believed: bool) -> tuple[Estimate, bool]:
        """The better of two answers to a frame, and whether the track may take it in. A believed frame is given up for
        a cold one only where the cold starts of several frames were better."""
        worth = self._plausible(warm)
        if not self._plausible(cold) or (worth and self._agree(warm, cold)):
            track.doubt = 0.0
            return warm, believed
        better = float(np.clip(evidence(cold) - evidence(warm), -1.0, 1.0))
        if not believed:
            use = cold if better > 0 or not worth else warm
            believed = self._plausible(use) and self._surprise(track, use) < self._limit
            track.doubt = 0.0 if believed else max(track.doubt + better, 0.0)
            return use, believed
        track.doubt = max(track.doubt + better, 0.0)
        if track.doubt < self.config.switch:
            return warm, True
        self._candidate = cold  # which begins the new track
        return cold, False

    def _near(self, track: _Track) -> Near:
        here = track.motion.placement
        return Near(here.T_camera_base, here.joint_states, self.shape.mean, self.shape.covariance)

    def _answer(self, track: _Track) -> Estimate:
        covariance = np.asarray(block_diag(track.motion.covariance + track.common, self.shape.covariance))
        return self.estimator.moved(track.last, self._near(track), covariance)

    def _surprise(self, track: _Track, single: Estimate) -> float:
        if not np.isfinite(single.covariance).all():
            return np.inf
        return track.motion.surprise(Placement.of(single), single.covariance[: self._size, : self._size])

    def _plausible(self, single: Estimate) -> bool:
        config, unit = self.config, self._unit
        shown = single.expected_error < config.worst_std * unit or (single.probability or 0.0) >= config.likely
        good = shown and single.residual < config.worst_residual * unit
        return bool(good and np.isfinite(single.covariance).all())

    def _agree(self, a: Estimate, b: Estimate) -> bool:
        turn = Rotation.from_matrix(b.T_camera_base[:3, :3] @ a.T_camera_base[:3, :3].T).magnitude()
        apart = np.sqrt(np.square(a.keypoints - b.keypoints).sum(1).mean())
        return bool(turn < self.config.same_turn and apart < self.config.same_place * self._unit)

    def _category_shape(self) -> ShapeBelief:
        prior = self.estimator.net.prior
        return ShapeBelief(self.config.shape, as_doubles(prior.beta_mean), as_doubles(prior.beta_covariance))


def _of_one_hand(known: Known, last: Estimate | None) -> Known:
    """What is known, with the hand that the ``last`` answer told: an object keeps it, and a shut door hardly tells."""
    if last is None or known.mirrored_probability is not None:
        return known
    return replace(known, mirrored_probability=last.mirrored_probability)


def _still_right(estimate: Estimate) -> float:
    """How likely no joint has moved farther meanwhile than a right answer may be off, by its covariance."""
    most = right_within(estimate.category, diagonal(estimate.canonical_keypoints))
    std = np.sqrt(estimate.covariance.diagonal()[6 : 6 + len(most)])
    return float(chi2.cdf(np.square(most / np.maximum(std, 1e-9)), 1).prod())


def evidence(estimate: Estimate) -> float:
    """How well model and network agree, nats per keypoint: the mean log density of the keypoints that the network saw,
    each with its own expected error."""
    squared, std = np.square(estimate.keypoints - estimate.observed_keypoints).sum(1), estimate.keypoint_std
    return float((-squared / (2 * std**2) - 3 * np.log(std)).mean())
