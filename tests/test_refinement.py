"""The optimisation-based estimator on random, well-conditioned priors whose truth is known."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
import scipy.optimize
import torch
from torch import Tensor

from omad.adam_recipe import refine_with_adam, snap_targets
from omad.categories import CATEGORIES, Category, JointSpec, PartSpec
from omad.errors import InputError
from omad.geometry import make_transform, rotation_angle, so3_exp
from omad.keypoint_jacobian import keypoint_jacobian
from omad.prior import OmadPrior
from omad.refinement import Refined, RefinementConfig, Refiner, State, Targets, free_directions, refine

CRANE = Category(
    name="crane",
    metres_per_unit=1.0,
    parts=(PartSpec("foot", 6), PartSpec("mast", 6), PartSpec("boom", 8), PartSpec("hook", 7)),
    joints=(
        JointSpec("slew", "revolute", 0, (0.0, 1.0, 0.0), (-1.5, 1.5)),
        JointSpec("reach", "prismatic", 1, (1.0, 0.0, 0.0), (-0.6, 0.6)),
        JointSpec("tilt", "revolute", 2, (0.0, 0.0, 1.0), (-1.2, 1.2)),
    ),
    rest=("closed",) * 3,
    basis_size=8,
)
"""Three joints in a row, one of them prismatic."""
CASES = (*CATEGORIES.values(), CRANE)
BACKENDS = ("torch", "kernel")
EXACT = RefinementConfig(
    prior_weight=0.0, huber=None, max_iterations=200, step_tolerance=1e-11, cost_tolerance=0.0, limit_sigma=0.02
)
WIDE = 10.0


@dataclass(frozen=True)
class Scene:
    """Observations of random objects."""

    prior: OmadPrior
    truth: State
    targets: Targets
    start: State
    limits: Tensor

    def refine(self, config: RefinementConfig, free: Tensor | None = None) -> Refined:
        return refine(self.prior, self.targets, self.start, self.limits, config, free)


def random_prior(category: Category, draw: torch.Generator) -> OmadPrior:
    prior = OmadPrior(category, generator=draw).double()
    with torch.no_grad():
        # A spread-out mean shape (first column) with independent variations of a tenth of its size.
        prior.learned_basis.copy_(0.2 * torch.randn(prior.learned_basis.shape, generator=draw, dtype=torch.float64))
        prior.learned_basis[..., 0] *= 4
        prior.joint_hidden.bias.copy_(0.3 * torch.randn(prior.joint_hidden.bias.shape, generator=draw))
        prior.beta_mean[0] = 1.0
        root = 0.3 * torch.eye(prior.basis_size) + 0.05 * torch.randn(
            prior.basis_size, prior.basis_size, generator=draw
        )
        prior.beta_covariance.copy_(root @ root.T)
    return prior


def scene(category: Category, batch: int = 12, noise: float = 0.0, seed: int = 0) -> Scene:
    draw = torch.Generator().manual_seed(seed)

    def normal(*shape: int) -> Tensor:
        return torch.randn(shape, generator=draw, dtype=torch.float64)

    prior = random_prior(category, draw)
    root = torch.linalg.cholesky(prior.beta_covariance)
    beta = prior.beta_mean + normal(batch, prior.basis_size) @ root.T
    limits = torch.tensor([joint.limits for joint in category.joints], dtype=torch.float64)
    share = torch.rand(batch, len(limits), generator=draw, dtype=torch.float64)
    states = limits[:, 0] + share * (limits[:, 1] - limits[:, 0])
    T = make_transform(so3_exp(normal(batch, 3)), normal(batch, 3) + torch.tensor([0.0, 0.0, 4.0]))
    truth = State(beta, states, T)
    with torch.no_grad():
        keypoints = prior.deform(beta, states, T)
    weights = 1 / (0.01 + 0.03 * torch.rand(keypoints.shape[:2], generator=draw, dtype=torch.float64)).square()
    keypoints = keypoints + noise * normal(*keypoints.shape) / weights.sqrt()[..., None]

    turn = math.radians(20) * torch.nn.functional.normalize(normal(batch, 3), dim=-1)
    start = State(
        beta + 0.2 * normal(batch, prior.basis_size),
        states + math.radians(20) * normal(*states.shape).sign(),
        make_transform(so3_exp(turn) @ T[:, :3, :3], T[:, :3, 3] + 0.1 * normal(batch, 3)),
    )
    return Scene(prior, truth, Targets(keypoints, weights), start, limits)


def error(found: State, truth: State) -> Tensor:
    """(B, 4) largest error of beta, states, rotation and translation."""
    return torch.stack(
        [
            (found.beta - truth.beta).abs().amax(1),
            (found.joint_states - truth.joint_states).abs().amax(1),
            rotation_angle(found.T_camera_base[:, :3, :3], truth.T_camera_base[:, :3, :3]),
            (found.T_camera_base - truth.T_camera_base)[:, :3, 3].abs().amax(1),
        ],
        1,
    )


def select(whole: Scene, rows: slice) -> Scene:
    def part(state: State) -> State:
        return State(state.beta[rows], state.joint_states[rows], state.T_camera_base[rows])

    targets = Targets(whole.targets.keypoints[rows], whole.targets.weights[rows])
    return Scene(whole.prior, part(whole.truth), targets, part(whole.start), whole.limits)


def moved(state: State, step: Tensor) -> State:
    """``state`` moved by a tangent step (B, P), differentiably."""
    J = state.joint_states.shape[1]
    T = state.T_camera_base
    pose = make_transform(so3_exp(step[:, :3]) @ T[:, :3, :3], T[:, :3, 3] + step[:, 3:6])
    return State(state.beta + step[:, 6 + J :], state.joint_states + step[:, 6 : 6 + J], pose)


each_case = pytest.mark.parametrize("category", CASES, ids=lambda c: c.name)
each_backend = pytest.mark.parametrize("backend", BACKENDS)


@each_case
def test_jacobian_is_the_forward_mode_derivative(category: Category) -> None:
    s = scene(category, batch=3)
    unknowns = 6 + s.truth.joint_states.shape[1] + s.prior.basis_size

    def keypoints(step: Tensor) -> Tensor:
        at = moved(s.start, step)
        return s.prior.deform(at.beta, at.joint_states, at.T_camera_base)

    with torch.no_grad():
        points, jacobian = keypoint_jacobian(s.prior, s.start)
    zero = torch.zeros(3, unknowns, dtype=torch.float64)
    reference = torch.func.jacfwd(lambda step: keypoints(step).sum(0))(zero)  # (M, 3, B, P)
    assert isinstance(reference, Tensor)
    torch.testing.assert_close(points, keypoints(zero).detach(), atol=1e-12, rtol=0)
    torch.testing.assert_close(jacobian, reference.detach().permute(2, 0, 1, 3), atol=1e-10, rtol=0)


@each_case
@each_backend
def test_recovers_the_truth_from_perturbed_starts(category: Category, backend) -> None:
    s = scene(category, batch=24)
    refined = s.refine(replace(EXACT, backend=backend))
    assert refined.converged.all()
    assert error(refined.state, s.truth).max() < 1e-4
    assert refined.residual.max() < 1e-6
    assert refined.iterations.max() < 40


@each_case
@pytest.mark.parametrize("huber", [None, 2.0])
def test_kernel_and_torch_agree(category: Category, huber: float | None) -> None:
    s = scene(category, noise=1.0)
    plain, fused = (s.refine(replace(EXACT, prior_weight=1.0, huber=huber, backend=b)) for b in BACKENDS)
    assert plain.converged.all()
    assert fused.converged.all()
    assert error(plain.state, fused.state).max() < 1e-8
    torch.testing.assert_close(plain.covariance, fused.covariance, atol=1e-9, rtol=1e-6)
    torch.testing.assert_close(plain.energy, fused.energy, atol=1e-8, rtol=1e-8)


@each_case
def test_placed_bases_agree_and_are_nearest(category: Category) -> None:
    s = scene(category, batch=6, noise=1.0)
    weights = s.targets.weights.clone()
    weights[:, 3] = 0.0  # one keypoint of each is not seen
    targets = replace(s.targets, weights=weights)
    plain, fused = (Refiner(s.prior, s.limits, RefinementConfig(backend=b)).placed(targets, s.start) for b in BACKENDS)
    torch.testing.assert_close(plain.T_camera_base, fused.T_camera_base, atol=1e-9, rtol=0)
    hold_all_but_the_base = free_directions(len(category.joints), s.prior.basis_size, hold_beta=True, hold_states=True)
    fitted = refine(s.prior, targets, fused, s.limits, EXACT, hold_all_but_the_base).state
    torch.testing.assert_close(fitted.T_camera_base, fused.T_camera_base, atol=1e-6, rtol=0)


@each_case
def test_same_optimum_as_scipy(category: Category) -> None:
    s = scene(category, batch=3, noise=1.0, seed=1)  # none of whose optima lies on a kink of the joint function's ReLU
    # unlimited, so that plain residuals of keypoints and prior are the whole energy
    s = replace(s, limits=torch.tensor([-WIDE, WIDE], dtype=torch.float64).expand(len(s.limits), 2))
    refined = s.refine(replace(EXACT, prior_weight=1.0))
    precision_root = torch.linalg.cholesky(torch.linalg.inv(s.prior.beta_covariance)).mT

    for index in range(3):
        start = select(s, slice(index, index + 1))

        def residuals(step: np.ndarray, start: Scene = start) -> np.ndarray:
            at = moved(start.start, torch.from_numpy(step)[None])
            with torch.no_grad():
                points = start.prior.deform(at.beta, at.joint_states, at.T_camera_base)
            seen = start.targets.weights.sqrt()[..., None] * (points - start.targets.keypoints)
            prior = (at.beta - start.prior.beta_mean) @ precision_root.mT
            return torch.cat([seen.flatten(), prior.flatten()]).numpy()

        unknowns = refined.covariance.shape[-1]
        reference = scipy.optimize.least_squares(residuals, np.zeros(unknowns), xtol=1e-12, ftol=1e-12, gtol=1e-12)
        found = moved(start.start, torch.from_numpy(reference.x)[None])
        ours = State(
            refined.state.beta[index : index + 1],
            refined.state.joint_states[index : index + 1],
            refined.state.T_camera_base[index : index + 1],
        )
        assert error(ours, found).max() < 1e-5
        hessian = reference.jac.T @ reference.jac
        std = np.sqrt(np.diagonal(np.linalg.inv(hessian)))[3:]  # scipy's rotation coordinates are the start's
        np.testing.assert_allclose(refined.std[index, 3:].numpy(), std, rtol=1e-3)


@each_backend
@pytest.mark.parametrize("where", ["keypoints", "weights", "beta", "pose"])
def test_broken_problem_changes_no_other(backend, where: str) -> None:
    s = scene(CRANE, batch=6, noise=1.0)
    config = RefinementConfig(backend=backend)
    clean = s.refine(config)
    broken = {
        "keypoints": s.targets.keypoints, "weights": s.targets.weights,
        "beta": s.start.beta, "pose": s.start.T_camera_base,
    }[where]  # fmt: skip
    broken[2] = torch.nan
    beside = s.refine(config)
    good = [0, 1, 3, 4, 5]
    for name in ("beta", "joint_states", "T_camera_base"):
        difference = getattr(beside.state, name)[good] - getattr(clean.state, name)[good]
        assert difference.abs().max() < 1e-12
    assert (beside.covariance[good] - clean.covariance[good]).abs().max() < 1e-12
    assert beside.converged.tolist() == [True, True, False, True, True, True]
    torch.testing.assert_close(beside.state.joint_states[2], s.start.joint_states[2], rtol=0, atol=0)


@each_backend
def test_a_batch_is_its_problems_one_by_one(backend) -> None:
    s = scene(CRANE, batch=5, noise=1.0)
    config = RefinementConfig(backend=backend)
    together = s.refine(config)
    for index in range(5):
        alone = select(s, slice(index, index + 1)).refine(config)
        assert (alone.state.beta[0] - together.state.beta[index]).abs().max() < 1e-9
        assert alone.iterations[0] == together.iterations[index]


@each_backend
def test_huber_survives_outliers(backend) -> None:
    s = scene(CRANE, noise=1.0)
    s.targets.keypoints[:, [2, 9, 20]] += 1.0
    plain = s.refine(RefinementConfig(backend=backend, huber=None))
    robust = s.refine(RefinementConfig(backend=backend, huber=2.0))
    assert (error(robust.state, s.truth).mean(0) < 0.5 * error(plain.state, s.truth).mean(0)).all()


@each_backend
def test_limits_hold_softly_on_either_side(backend) -> None:
    s = scene(CRANE, noise=1.0)
    states = s.truth.joint_states
    # Each true state lies 0.3 outside the limits that are told.
    above = replace(s, limits=torch.stack([states - 1.3, states - 0.3], -1))
    below = replace(s, limits=torch.stack([states + 0.3, states + 1.3], -1))
    strict, loose = (RefinementConfig(backend=backend, limit_sigma=sigma) for sigma in (1e-4, 1e3))
    for told, edge in ((above, states - 0.3), (below, states + 0.3)):
        assert (told.refine(strict).state.joint_states - edge).abs().max() < 0.02
        assert (told.refine(loose).state.joint_states - states).abs().max() < 0.2
    inside = replace(s, limits=torch.stack([states - 1, states + 1], -1))
    torch.testing.assert_close(inside.refine(strict).state.beta, inside.refine(loose).state.beta, atol=1e-6, rtol=0)


@each_backend
def test_held_unknowns_keep_every_bit(backend) -> None:
    s = scene(CRANE, noise=1.0)
    J, D, config = 3, s.prior.basis_size, RefinementConfig(backend=backend)
    start, rotation = s.start, slice(0, 3)
    held = s.refine(config, free_directions(J, D, hold_beta=True))
    assert torch.equal(held.state.beta, start.beta)
    assert (held.beta_std == 0).all()
    assert (held.joint_state_std > 0).all()
    held = s.refine(config, free_directions(J, D, hold_states=True))
    assert torch.equal(held.state.joint_states, start.joint_states)
    held = s.refine(config, free_directions(J, D, hold_states=(True, False, True)))
    assert torch.equal(held.state.joint_states[:, [0, 2]], start.joint_states[:, [0, 2]])
    assert (held.state.joint_states[:, 1] != start.joint_states[:, 1]).all()
    held = s.refine(config, free_directions(J, D, hold_rotation=True))
    assert torch.equal(held.state.T_camera_base[:, :3, rotation], start.T_camera_base[:, :3, rotation])
    assert (held.rotation_std == 0).all()
    held = s.refine(config, free_directions(J, D, hold_translation=True))
    assert torch.equal(held.state.T_camera_base[:, :3, 3], start.T_camera_base[:, :3, 3])
    assert (held.translation_std == 0).all()


@each_backend
def test_known_gravity_is_kept_and_helps(backend) -> None:
    s = scene(CRANE, batch=1, noise=0.0)
    down = s.truth.T_camera_base[0, :3, :3] @ torch.tensor([0.0, -1.0, 0.0], dtype=torch.float64)
    turned = so3_exp(0.4 * down[None]) @ s.truth.T_camera_base[:, :3, :3]
    start = replace(s.start, T_camera_base=make_transform(turned, s.start.T_camera_base[:, :3, 3]))
    gravity = (float(down[0]), float(down[1]), float(down[2]))
    free = free_directions(3, s.prior.basis_size, gravity=gravity)
    refined = replace(s, start=start).refine(replace(EXACT, backend=backend), free)
    up = refined.state.T_camera_base[0, :3, 1]
    torch.testing.assert_close(up, -down, atol=1e-12, rtol=0)
    assert error(refined.state, s.truth).max() < 1e-4
    variance = refined.covariance[0, :3, :3]
    assert torch.linalg.matrix_rank(variance, rtol=1e-9) == 1


@each_case
def test_covariance_says_how_far_estimates_scatter(category: Category) -> None:
    """Objects drawn from the prior, noise as the weights say: errors over stated deviations have unit variance."""
    draws = [scene(category, batch=500, noise=1.0, seed=seed) for seed in (1, 2)]
    ratios = []
    for s in draws:
        s = replace(s, start=s.truth, limits=torch.tensor([-WIDE, WIDE]).double().expand(len(s.limits), 2))
        refined = s.refine(RefinementConfig(huber=None))
        off = torch.cat(
            [
                (refined.state.T_camera_base - s.truth.T_camera_base)[:, :3, 3],
                refined.state.joint_states - s.truth.joint_states,
                refined.state.beta - s.truth.beta,
            ],
            1,
        )
        ratios.append((off / refined.std[:, 3:]).square().mean(0).sqrt())
        turn = rotation_angle(refined.state.T_camera_base[:, :3, :3], s.truth.T_camera_base[:, :3, :3])
        stated = refined.rotation_std.square().sum(1)
        ratios.append((turn.square() / stated).mean().sqrt()[None])
    assert torch.cat(ratios).sub(1).abs().max() < 0.2


@each_backend
def test_prior_decides_what_keypoints_do_not_show(backend) -> None:
    s = scene(CRANE, batch=4, noise=1.0)
    s.targets.weights[:] = 0
    s.targets.keypoints[:] = torch.nan  # left out by weight, whatever they hold
    refined = s.refine(RefinementConfig(backend=backend))
    torch.testing.assert_close(refined.state.beta, s.prior.beta_mean.expand(4, -1), atol=1e-4, rtol=0)
    assert torch.equal(refined.state.T_camera_base, s.start.T_camera_base)
    assert (refined.residual == 0).all()
    torch.testing.assert_close(refined.beta_std[0], s.prior.beta_covariance.diagonal().sqrt(), rtol=1e-4, atol=0)
    assert (refined.rotation_std > 1e3).all()


@each_backend
def test_single_precision(backend) -> None:
    s = scene(CRANE, noise=1.0)
    exact = s.refine(RefinementConfig(backend=backend))
    s.prior.float()
    rough = refine(
        s.prior,
        Targets(s.targets.keypoints.float(), s.targets.weights.float()),
        State(s.start.beta.float(), s.start.joint_states.float(), s.start.T_camera_base.float()),
        s.limits.float(),
        RefinementConfig(backend=backend),
    )
    assert rough.state.beta.dtype == torch.float32
    assert rough.converged.all()
    doubled = State(rough.state.beta.double(), rough.state.joint_states.double(), rough.state.T_camera_base.double())
    assert error(doubled, exact.state).max() < 2e-3


def test_wrong_input_is_named() -> None:
    s = scene(CRANE, batch=2)
    with pytest.raises(InputError, match=r"initial\.beta.*\(2, 8\)"):
        replace(s, start=replace(s.start, beta=s.start.beta[:, :5])).refine(EXACT)
    with pytest.raises(InputError, match=r"targets\.weights: negative"):
        replace(s, targets=replace(s.targets, weights=-s.targets.weights)).refine(EXACT)
    with pytest.raises(InputError, match=r"targets\.keypoints: torch\.float32"):
        replace(s, targets=replace(s.targets, keypoints=s.targets.keypoints.float())).refine(EXACT)
    with pytest.raises(InputError, match="limits"):
        replace(s, limits=s.limits[:1]).refine(EXACT)
    with pytest.raises(InputError, match="hold_states"):
        free_directions(3, 8, hold_states=(True,))


@each_case
def test_adam_recipe_ends_no_lower(category: Category) -> None:
    s = scene(category, batch=2, noise=1.0)
    wide = replace(s, limits=torch.tensor([-WIDE, WIDE]).double().expand(len(s.limits), 2))
    ours = wide.refine(RefinementConfig(prior_weight=0.0, huber=None))
    adam = refine_with_adam(s.prior, s.targets, s.start)
    assert (adam.energy >= ours.energy - 1e-9).all()
    assert (adam.energy < 20 * ours.energy).all()
    assert (adam.steps % 50 == 0).all()
    alone = refine_with_adam(s.prior, *_first(s))
    torch.testing.assert_close(alone.state.beta[0], adam.state.beta[0], atol=1e-6, rtol=0)


def _first(s: Scene) -> tuple[Targets, State]:
    one = select(s, slice(0, 1))
    return one.targets, one.start


def test_targets_snap_to_the_nearest_point_or_are_dropped() -> None:
    targets = Targets(torch.tensor([[[0.0, 0, 0], [1.0, 0, 0]]]), torch.ones(1, 2))
    snapped = snap_targets(targets, torch.tensor([[[0.05, 0, 0], [0.0, 0.09, 0], [2.0, 0, 0]]]))
    torch.testing.assert_close(snapped.keypoints[0, 0], torch.tensor([0.05, 0, 0]))
    assert snapped.weights.tolist() == [[1.0, 0.0]]
