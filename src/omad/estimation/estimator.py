"""The estimator: cloud -> network -> refinement -> Estimate.

    1. a first look in camera axes; its keypoints are fitted by least squares
    2. a second look in the base frame so found, where every object stands alike; fitted again

Where the first look finds other things than the object, all choices are labelled, and it is repeated without them.
Where the last look is unsure, it may have begun the wrong way round: others begin in turned frames, the surest counts.
So they do where the answer is improbable; then the most probable counts.

Each look shows the network a few random choices of the points, every second of them in a mirror where objects are
their own mirror images, and averages what it says, by confidence.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import accumulate
from numbers import Integral
from pathlib import Path
from typing import Any, Self, overload

import numpy as np
import torch
from torch import Tensor

from omad.common.arrays import as_numpy
from omad.common.errors import InputError
from omad.common.runtime import Stopwatch, pick_device, undisturbed, work_in_forks
from omad.geometry.transforms import transform_points
from omad.model.checkpoint import find_weights, load
from omad.model.fitting.energy import RefinementConfig
from omad.model.fitting.leaning import leaning
from omad.model.fitting.refinement import Refiner
from omad.model.fitting.state import Refined, State, Targets
from omad.model.inference.network import inference_net
from omad.model.network_input import first_frame, to_input_frame
from omad.model.omadnet import OmadNet
from omad.model.surfaces.surfaces import Surfaces
from omad.objects.category import Category
from omad.sensing.observation import Observation

from .ahead import compile_ahead
from .confidence.model import Confidence
from .estimate import Estimate, PoseEstimate
from .known import NOTHING_KNOWN, Known, Near, check_known
from .looks.answers import Answers, state_std
from .looks.beginning import ANYWHERE, Beginning
from .looks.either_hand import surer_hands
from .looks.improbable import is_improbable, likelier, turned_frames
from .looks.look import Crowd, Look, rows_of, with_rows
from .looks.mirror import Mirror
from .looks.shown import Shown, check_observations
from .looks.turned import HALF_TURNS, UNSURE, surer
from .several_views import Rig, one_answer, relative_poses

Refine = Callable[[Refiner, Targets, State], Refined]
"""Minimises the energy that a refiner states, from an initial state."""
MOST = 4096
"""Samples of a cloud, and observations at a time."""
SEEDS = 2**64


@dataclass(frozen=True)
class EstimatorConfig:
    """How an observation is looked at."""

    samples: tuple[int, ...] = (1, 3)
    """Per look, how many random choices of the points it averages. The first look only has to find the frame."""
    near_samples: int = 2
    """The same of the only look at an object that is known to be near a place."""
    refinement: RefinementConfig = RefinementConfig(step_tolerance=1e-4, cost_tolerance=1e-5)
    """Tolerances a hundred times below the network's own error: half the iterations of the defaults."""
    confidence: bool = True
    """False: all keypoints of an object count alike, as in the paper; for comparison."""
    seed: int = 0
    """Which points are chosen; the same observation and seed give the same estimate.
    Beside others in a batch sums are rounded otherwise, which may decide what an improbable one is."""
    batch: int = 128
    """Observations that go through the network together."""
    reconsiders: bool = True
    """Whether improbable answers are compared with others."""

    def __post_init__(self) -> None:
        samples = tuple(self.samples) if isinstance(self.samples, tuple | list) else ()
        counts = {"samples": samples, "near_samples": (self.near_samples,), "batch": (self.batch,)}
        for name, each in counts.items():
            if not each or not all(isinstance(count, Integral) and 1 <= int(count) <= MOST for count in each):
                got = f"got {getattr(self, name)!r}"
                raise InputError(f"EstimatorConfig: {name} takes whole numbers from 1 to {MOST}, {got}")
        object.__setattr__(self, "samples", samples)  # hashable
        if not isinstance(self.seed, Integral) or not 0 <= self.seed < SEEDS:
            raise InputError("EstimatorConfig: seed is a whole number from 0, below 2^64")
        object.__setattr__(self, "seed", int(self.seed))  # NumPy's own cannot be added to beyond their range

    @classmethod
    def fast(cls) -> Self:
        """Half the passes of the network, for 2 to 16 % larger errors of joint states and axes up to half as far off
        again; ``docs/speed.md`` has the figures."""
        return cls(samples=(1, 1), near_samples=1, reconsiders=False)


class Estimator:
    """Recovers shape, pose and joints of one category's objects from single views."""

    def __init__(
        self,
        net: OmadNet,
        config: EstimatorConfig | None = None,
        device: str | torch.device = "cpu",
        refine: Refine = Refiner.__call__,
        confidence: Confidence | None = None,
        surfaces: Surfaces | None = None,
    ) -> None:
        """``refine`` takes the place of least squares, for comparison. Without a ``confidence``, answers have no
        probability, and their joints the least squares' own standard deviations. Estimates take their meshes from
        ``surfaces``; without, they are hulls of keypoints. Raises InputError where ``config`` is no EstimatorConfig."""
        if not isinstance(config, EstimatorConfig | None):
            raise InputError(f"config: is {type(config).__name__}; give an EstimatorConfig, EstimatorConfig.fast() say")
        work_in_forks()
        self.device = torch.device(device)
        self.net = net.to(self.device).eval()
        self._forward = inference_net(self.net)
        self.config = config or EstimatorConfig()
        self.refine = refine
        self.hand = () if confidence is None else confidence.hand
        mirror = Mirror.of(net.category, net.tells_outside)
        self._mirror = mirror and mirror.to(self.device)
        self.answers = Answers(net.category, net.prior, confidence, surfaces)
        self._kept: dict[int, Refiner] = {}

    @classmethod
    @undisturbed()
    def from_pretrained(
        cls,
        weights: str | Path,
        device: str = "auto",
        config: EstimatorConfig | None = None,
        refine: Refine = Refiner.__call__,
    ) -> Self:
        """``weights``: a category with shipped weights, a checkpoint folder, or the address of one (``https://`` or any
        other that fsspec knows, with ``#sha256=`` of its manifest where it is pinned), which is fetched once. What is
        not yet compiled for this machine is compiled here, so that no answer waits for it. Raises InputError."""
        folder = find_weights(weights)
        net = load(OmadNet, folder)
        confidence, surfaces = Confidence.load(folder, net.category), Surfaces.beside(folder, net.prior, net.category)
        estimator = cls(net, config, pick_device(device), refine, confidence, surfaces)
        hands = net.category.either_hand, bool(estimator.hand)
        ways = net.backbone.config, net.tells_outside, hands, estimator.answers.asked
        settings = estimator.config, estimator.device.type, refine, ways
        compile_ahead(estimator.first_answers, estimator.category, settings)
        return estimator

    @property
    def category(self) -> Category:
        """What it estimates."""
        return self.net.category

    @property
    def surfaces(self) -> Surfaces | None:
        """Where its estimates' meshes come from."""
        return self.answers.surfaces

    @overload
    def __call__(self, observation: Observation, known: Known = NOTHING_KNOWN) -> Estimate: ...
    @overload
    def __call__(
        self, observation: Sequence[Observation], known: Known = NOTHING_KNOWN, T_world_camera: Any = None
    ) -> list[Estimate]: ...
    def __call__(
        self, observation: Observation | Sequence[Observation], known: Known = NOTHING_KNOWN, T_world_camera: Any = None
    ) -> Estimate | list[Estimate]:
        """Estimate one observation, or several as a batch. What is ``known`` holds for all of them, and is kept.

        With ``T_world_camera`` (V, 4, 4), in metres, the V observations are views of one object at one moment, by
        cameras whose places in any one frame are known: they get one answer, given in each camera's own frame. What is
        ``known`` of gravity is then in the first camera's frame. Raises InputError for wrong shapes and poses."""
        if T_world_camera is not None:
            return self._together(observation, known, T_world_camera)
        if isinstance(observation, Observation):
            return self([observation], known)[0]
        return self.reconsidered(observation, self.first_answers(observation, known), known)

    def first_answers(self, observations: Sequence[Observation], known: Known = NOTHING_KNOWN) -> list[Estimate]:
        """The same before improbable answers are compared with others: for what is compared with other categories'."""
        size, views = self.config.batch, check_observations(observations)
        return [e for i in range(0, len(views), size) for e in self._estimate(views[i : i + size], known)]

    def reconsidered(
        self, observations: Sequence[Observation], estimates: Sequence[Estimate], known: Known = NOTHING_KNOWN
    ) -> list[Estimate]:
        """First answers; an improbable one is compared with others to the same observation, which take up to four
        times as long as it did."""
        found = list(estimates)
        for i, estimate in enumerate(estimates if self.config.reconsiders else ()):
            if is_improbable(estimate):
                frames = turned_frames(estimate)
                others = self._estimate([observations[i]] * len(frames), known, Beginning(frames=frames))
                others += self._estimate([observations[i]], known, Beginning(choice=1))
                found[i] = likelier(estimate, others)
        return found

    def near(self, observation: Observation, near: Near, known: Known = NOTHING_KNOWN) -> Estimate:
        """Estimate an object that was seen before, a moment ago say: one look is enough, which takes half the time."""
        check_observations([observation])
        return self._estimate([observation], known, Beginning(near))[0]

    def moved(self, estimate: Estimate, state: Near, covariance: np.ndarray) -> Estimate:
        """The answer with another shape, pose and joint states, those of a filter say; ``covariance`` (P, P) theirs, of
        least squares. Deviations of joints and base are as much larger or smaller than these say as its own are."""
        turned = state.mirrored() if estimate.of_other_hand else state
        posed = self.answers.posed(turned.start(self.category, self.net.prior.learned_basis))
        std, before = (state_std(each[None], self.category) for each in (covariance, estimate.covariance))
        told, tail = np.array([[(joint.state_std, joint.tail) for joint in estimate.joints]]).transpose(2, 0, 1)
        std *= np.divide(told, before, out=np.ones_like(std), where=before > 0)
        [moved] = PoseEstimate.of(self.category, posed, std, tail)
        moved = moved.reflected(self.category.turning) if estimate.of_other_hand else moved
        variance = covariance.diagonal()[:6] / np.maximum(estimate.covariance.diagonal()[:6], 1e-30)
        return estimate.placed_as(moved, covariance, estimate.base_std * np.sqrt(variance))

    def _together(self, views: Observation | Sequence[Observation], known: Known, poses: Any) -> list[Estimate]:
        if isinstance(views, Observation) or not views:
            raise InputError("T_world_camera: is for several views of one object; give a list of observations with it")
        views = check_observations(views)
        T = relative_poses(poses, len(views))
        check_known(known, self.category, self.net.prior.basis_size)
        if len(views) == 1:
            return self(views, known)
        alone = [self._estimate([view], own)[0] for view, own in zip(views, known.seen_from(T), strict=True)]
        shared = self.answers.shared
        rig = Rig.of(T, alone, shared, self.net.prior.learned_basis)
        return one_answer(self._estimate(views, known, Beginning(rig=rig)), alone, shared)

    def _estimate(
        self, observations: Sequence[Observation], known: Known, begin: Beginning = ANYWHERE
    ) -> list[Estimate]:
        check_known(known, self.category, self.net.prior.basis_size)
        if not self.category.either_hand:
            return self._of_one_hand(observations, known, begin)
        plain, images = self.of_each_hand(observations, known, begin)
        return surer_hands(plain, images, self.hand, begin.rig is not None, known.mirrored_probability)

    def of_each_hand(
        self, observations: Sequence[Observation], known: Known, begin: Beginning = ANYWHERE
    ) -> tuple[list[Estimate], list[Estimate]]:
        """Answers to the views, and to what they show in a mirror, where objects of the other hand are of the
        category's; the latter still in the mirror."""
        seen = [observation.mirrored() for observation in observations]
        images = self._of_one_hand(seen, known.mirrored(), begin.mirrored())
        return self._of_one_hand(observations, known, begin), images

    @undisturbed()
    def _of_one_hand(self, observations: Sequence[Observation], known: Known, begin: Beginning) -> list[Estimate]:
        config, watch, near, rig = self.config, Stopwatch(self.device), begin.near, begin.rig
        looks = config.samples if near is None else (config.near_samples,)
        size, seed = self.net.backbone.config.points, (config.seed + begin.choice) % SEEDS
        shown = Shown.of(observations, size, sum(looks), seed, self.category, self.device)
        level = known.levelling(shown.clouds, None if rig is None else rig.T_first_camera)
        given = begin.T_camera_base(self.category, shown.clouds)
        shown, first, crowd = self._look_first(shown, looks, given, level, seed)
        watch.lap("network")
        start = None if near is None else near.start(self.category, shown.clouds)
        last, refined = first, self._refine(first, start, known, near, rig)
        watch.lap("refinement")
        for done, count in zip(accumulate(looks), looks[1:], strict=False):
            start = refined.state
            clouds = shown.clouds[:, done : done + count]
            last = self._look(clouds, start.T_camera_base, labels=done + count == sum(looks))
            watch.lap("network")
            refined = self._refine(last, start, known, near, rig)
            watch.lap("refinement")
        if begin.is_anywhere:
            if crowd is not None and len(looks) > 1:
                shown, last, refined = self._look_at_crowd(crowd, shown, last, refined, known)
            last, refined = self._look_turned(shown, last, refined, known)
            watch.lap("network")
        if self.net.own_states and known.is_nothing and rig is None:
            own, prior = last.state.joint_states, self.net.prior
            refined = leaning(refined, own, self.net.own_states, prior, last.targets)
        return self.answers(shown, first, last, refined, watch.shares(len(observations)))

    def _look_first(
        self, shown: Shown, looks: Sequence[int], given: Tensor | None, level: Tensor, seed: int
    ) -> tuple[Shown, Look, Crowd | None]:
        """The first of the ``looks``, in the frames ``given``, or in ``level`` ones around the clouds; where it finds
        other things than the object, and sees that more surely without them, what is shown is without them."""
        labels = self.net.tells_outside
        frame = first_frame(shown.clouds.flatten(1, 2)) @ level if given is None else given
        look = self._look(shown.clouds[:, : looks[0]], frame, labels or len(looks) == 1)
        crowded = shown.crowded(as_numpy(look.part_logits)) if labels else []
        if not crowded:
            return shown, look, None
        rows = torch.tensor(crowded, device=self.device)
        said = self._look(shown.clouds[rows], frame[rows], labels=True).part_logits
        cleaned = shown.without_outside(crowded, as_numpy(said), seed)
        clouds = cleaned.clouds[rows]
        frame = first_frame(clouds.flatten(1, 2)) @ level[rows] if given is None else given[rows]
        without = self._look(clouds[:, : looks[0]], frame, labels=True)
        # what is said of single points may be wrong: then the object is seen less surely without them
        surer = torch.nonzero(without.expected_error < look.expected_error[rows])[:, 0]
        if not len(surer):
            return shown, look, None
        rows = rows[surer]
        crowd = Crowd(rows, shown, look.of(rows))
        return shown.with_rows_of(cleaned, rows.tolist()), look.with_rows(rows, without.of(surer)), crowd

    def _look_at_crowd(
        self, crowd: Crowd, shown: Shown, last: Look, refined: Refined, known: Known
    ) -> tuple[Shown, Look, Refined]:
        """Of the clouds that points were left out of, look again at all of their points. Where that answer is surer
        than the ``last``, it takes its place."""
        start = self._refine(crowd.look, None, known, None).state
        again = self._look(crowd.shown.clouds[crowd.rows, -last.samples :], start.T_camera_base, labels=True)
        whole = self._refine(again, start, known, None)
        better = torch.nonzero(again.expected_error < last.expected_error[crowd.rows])[:, 0]
        rows = crowd.rows[better]
        shown = shown.with_rows_of(crowd.shown, rows.tolist())
        return shown, last.with_rows(rows, again.of(better)), with_rows(refined, rows, rows_of(whole, better))

    def _look_turned(self, shown: Shown, last: Look, refined: Refined, known: Known) -> tuple[Look, Refined]:
        """Of clouds that the ``last`` look is unsure of, look again in its frame turned by half about each axis. Where
        one of these answers is surer, it takes the place of those given."""
        rows = torch.nonzero(last.expected_error > UNSURE)[:, 0]
        if not len(rows):
            return last, refined
        clouds = shown.clouds[rows].repeat_interleave(len(HALF_TURNS), 0)
        frame = (refined.state.T_camera_base[rows, None] @ HALF_TURNS.to(clouds)).flatten(0, 1)
        first = self._look(clouds[:, : self.config.samples[0]], frame, labels=False)
        start = self._refine(first, None, known, None).state
        again = self._look(clouds[:, -last.samples :], start.T_camera_base, labels=True)
        turned = self._refine(again, start, known, None)
        before, now = refined.state.T_camera_base[rows], turned.state.T_camera_base
        better, best = surer(last.expected_error[rows], before, again.expected_error, now)
        rows, chosen = rows[better], better * len(HALF_TURNS) + best
        return last.with_rows(rows, again.of(chosen)), with_rows(refined, rows, rows_of(turned, chosen))

    def _look(self, clouds: Tensor, frame: Tensor, labels: bool) -> Look:
        """Run the network in ``frame`` (B, 4, 4) on all samples of each cloud and average its answers."""
        samples = clouds.shape[1]
        shown = to_input_frame(clouds.flatten(1, 2), frame).view(-1, *clouds.shape[2:])
        if self._mirror is None:
            said = self._forward(shown, labels)
        else:
            images = torch.arange(len(shown), device=shown.device) % samples % 2 == 1
            said = self._mirror.back(self._forward(self._mirror.images(shown, images), labels), images)
        log_sigma = said.log_sigma
        if not self.config.confidence:
            log_sigma = log_sigma.mean(-1, keepdim=True).expand_as(log_sigma)

        def each(values: Tensor) -> Tensor:
            return values.unflatten(0, (-1, samples))

        precision = each((-2 * log_sigma).exp())
        total = precision.sum(1)
        mean = (precision[..., None] * each(said.keypoints)).sum(1) / total[..., None]
        return Look(Targets(transform_points(frame, mean), total / samples), said, samples, frame)

    def _refine(
        self, look: Look, start: State | None, known: Known, near: Near | None, rig: Rig | None = None
    ) -> Refined:
        """From ``start``, or where there is none from the network's answer with the base where its keypoints say: they
        have no seam, as its quaternion has one somewhere on the circle around the object."""
        refiner, targets = self._refiner(known), look.targets
        start = start or refiner.with_fitted_pose(targets, look.state)
        if rig is not None:
            start, targets = rig.in_first(start), rig.carried(targets)
        start = start if known.is_nothing else known.apply_to(start, self.category)
        if near is not None:
            refiner = refiner.with_shape_prior(torch.as_tensor(near.beta), torch.as_tensor(near.beta_covariance))
        refined = self.refine(refiner, targets, start)
        if rig is None:
            return refined
        prior, alone = self.net.prior, refined.state
        best, together = rig.together(targets, prior.deform(alone.beta, alone.joint_states, alone.T_camera_base))
        start = State.unpack(alone.pack()[best], len(self.category.joints))
        return rig.each(self.refine(self._refiner(known, len(alone.beta)), together, start), prior, look.targets)

    def _refiner(self, known: Known, views: int = 1) -> Refiner:
        """For targets that have every keypoint once a view. Those for nothing known are kept."""
        config, prior = self.config.refinement, self.net.prior
        kept = self._kept.get(views)
        if known.is_nothing and kept is not None and kept.config is config:
            return kept
        limits = torch.as_tensor(self.category.limits, dtype=torch.float32, device=self.device)
        refiner = Refiner(prior.repeated(views), limits, config, known.free(self.category, prior.basis_size))
        if known.is_nothing:
            self._kept[views] = refiner
        return refiner
