"""The optimisation-based estimator on random, well-conditioned priors whose truth is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.optimize
import torch
from torch import Tensor

from helpers.categories import DRAWER, LAPTOP
from helpers.scenes import CASES, CRANE, WIDE, Scene, scene
from omad.common.errors import InputError
from omad.evaluation.baselines.adam import refine_with_adam
from omad.geometry.least_squares import TrustRegionConfig
from omad.geometry.transforms import make_transform, rotation_angle, so3_exp
from omad.model.fitting.energy import RefinementConfig, keypoint_jacobian
from omad.model.fitting.refinement import Refiner, free_directions
from omad.model.fitting.state import Refined, State, Targets
from omad.objects.category import Category

BACKENDS = ("torch", "kernel")
EXACT = RefinementConfig(
    prior_weight=0.0, huber=None, max_iterations=200, step_tolerance=1e-11, cost_tolerance=0.0, limit_sigma=0.02
)


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


def std(refined: Refined) -> Tensor:
    """(B, P) standard deviations."""
    return refined.covariance.diagonal(dim1=-2, dim2=-1).sqrt()


each_case = pytest.mark.parametrize("category", CASES, ids=lambda c: c.name)
each_backend = pytest.mark.parametrize("backend", BACKENDS)


@each_case
@pytest.mark.parametrize("loose", [0, 2])
def test_jacobian_is_the_forward_mode_derivative(category: Category, loose: int) -> None:
    s = scene(category, batch=3, loose=loose)
    unknowns = 6 + s.truth.joint_states.shape[1] + s.prior.basis_size

    def keypoints(step: Tensor) -> Tensor:
        at = s.start.moved(step)
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


@each_backend
def test_a_single_keypoint_is_enough_to_begin_with(backend) -> None:
    """It tells of no rotation."""
    s = scene(CASES[0], batch=1)
    weights = torch.zeros_like(s.targets.weights)
    weights[:, 0] = 100.0
    targets, refiner = (
        Targets(s.targets.keypoints, weights),
        Refiner(s.prior, s.limits, RefinementConfig(backend=backend)),
    )
    refined = refiner(targets, refiner.with_fitted_pose(targets, s.start))
    assert refined.state.T_camera_base.isfinite().all()
    assert refined.residual.max() < 1e-6


@pytest.mark.slow
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


@pytest.mark.slow
@each_case
@pytest.mark.parametrize("loose", [0, 2])
@pytest.mark.parametrize("trust_region", [TrustRegionConfig(), TrustRegionConfig(initial_damping=10.0)])
def test_kernel_and_torch_walk_the_same_iterations(
    category: Category, trust_region: TrustRegionConfig, loose: int
) -> None:
    s = scene(category, batch=8, noise=1.0, loose=loose)
    for steps in (1, 2, 3, 5, 8):
        config = RefinementConfig(max_iterations=steps, trust_region=trust_region)
        plain, fused = (s.refine(replace(config, backend=b)) for b in BACKENDS)
        assert torch.equal(plain.iterations, fused.iterations)
        assert torch.equal(plain.converged, fused.converged)
        assert error(plain.state, fused.state).max() < 1e-8


@each_case
def test_settings_of_the_trust_region_reach_both_solvers(category: Category) -> None:
    s = scene(category, batch=4, noise=1.0)
    for backend in BACKENDS:
        usual, timid = (
            s.refine(RefinementConfig(max_iterations=1, backend=backend, trust_region=TrustRegionConfig(damping)))
            for damping in (1e-3, 1e3)
        )
        moved = [(found.state.joint_states - s.start.joint_states).abs().amax(1) for found in (usual, timid)]
        assert (moved[1] < 0.1 * moved[0]).all()
        stopped = s.refine(RefinementConfig(backend=backend, trust_region=TrustRegionConfig(1e-3, max_damping=1e-4)))
        assert (stopped.iterations <= 1).all()


@each_case
def test_placed_bases_agree_and_are_nearest(category: Category) -> None:
    s = scene(category, batch=6, noise=1.0)
    weights = s.targets.weights.clone()
    weights[:, 3] = 0.0  # one keypoint of each is not seen
    targets = replace(s.targets, weights=weights)
    plain, fused = (
        Refiner(s.prior, s.limits, RefinementConfig(backend=b)).with_fitted_pose(targets, s.start) for b in BACKENDS
    )
    torch.testing.assert_close(plain.T_camera_base, fused.T_camera_base, atol=1e-9, rtol=0)
    hold_all_but_the_base = free_directions(len(category.joints), s.prior.basis_size, hold_beta=True, hold_states=True)
    fitted = Refiner(s.prior, s.limits, EXACT, hold_all_but_the_base)(targets, fused).state
    torch.testing.assert_close(fitted.T_camera_base, fused.T_camera_base, atol=1e-6, rtol=0)


@pytest.mark.parametrize("broken", ["one left out", "keypoints", "weights"])
def test_a_base_that_cannot_be_placed_spoils_no_other(broken: str) -> None:
    s = scene(CRANE, batch=3, noise=1.0)
    clean = Refiner(s.prior, s.limits).with_fitted_pose(s.targets, s.start).T_camera_base
    if broken == "weights":
        s.targets.weights[1] = 0.0
    else:
        s.targets.keypoints[1, : 1 if broken == "one left out" else None] = torch.nan
        s.targets.weights[1, 0] = 0.0
    plain, fused = (
        Refiner(s.prior, s.limits, RefinementConfig(backend=b)).with_fitted_pose(s.targets, s.start).T_camera_base
        for b in BACKENDS
    )
    for found in (plain, fused):
        torch.testing.assert_close(found[[0, 2]], clean[[0, 2]], atol=1e-9, rtol=0)
        assert found[1].isfinite().all() == (broken == "one left out")
    if broken == "one left out":
        torch.testing.assert_close(plain[1], fused[1], atol=1e-9, rtol=0)


@pytest.mark.slow
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
            at = start.start.moved(torch.from_numpy(step)[None])
            with torch.no_grad():
                points = start.prior.deform(at.beta, at.joint_states, at.T_camera_base)
            seen = start.targets.weights.sqrt()[..., None] * (points - start.targets.keypoints)
            prior = (at.beta - start.prior.beta_mean) @ precision_root.mT
            return torch.cat([seen.flatten(), prior.flatten()]).numpy()

        unknowns = refined.covariance.shape[-1]
        reference = scipy.optimize.least_squares(residuals, np.zeros(unknowns), xtol=1e-12, ftol=1e-12, gtol=1e-12)
        found = start.start.moved(torch.from_numpy(reference.x)[None])
        ours = State(
            refined.state.beta[index : index + 1],
            refined.state.joint_states[index : index + 1],
            refined.state.T_camera_base[index : index + 1],
        )
        assert error(ours, found).max() < 1e-5
        hessian = reference.jac.T @ reference.jac
        expected = np.sqrt(np.diagonal(np.linalg.inv(hessian)))[3:]  # scipy's rotation coordinates are the start's
        np.testing.assert_allclose(std(refined)[index, 3:].numpy(), expected, rtol=1e-3)


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
    assert beside.covariance[2].isnan().all()
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


@pytest.mark.slow
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


@pytest.mark.slow
@each_backend
def test_held_unknowns_keep_every_bit(backend) -> None:
    s = scene(CRANE, noise=1.0)
    J, D, config = 3, s.prior.basis_size, RefinementConfig(backend=backend)
    start = s.start
    held = s.refine(config, free_directions(J, D, hold_beta=True))
    assert torch.equal(held.state.beta, start.beta)
    assert (std(held)[:, 6 + J :] == 0).all()
    assert (std(held)[:, 6 : 6 + J] > 0).all()
    held = s.refine(config, free_directions(J, D, hold_states=True))
    assert torch.equal(held.state.joint_states, start.joint_states)
    held = s.refine(config, free_directions(J, D, hold_states=(True, False, True)))
    assert torch.equal(held.state.joint_states[:, [0, 2]], start.joint_states[:, [0, 2]])
    assert (held.state.joint_states[:, 1] != start.joint_states[:, 1]).all()


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
        ratios.append((off / std(refined)[:, 3:]).square().mean(0).sqrt())
        turn = rotation_angle(refined.state.T_camera_base[:, :3, :3], s.truth.T_camera_base[:, :3, :3])
        stated = std(refined)[:, :3].square().sum(1)
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
    torch.testing.assert_close(std(refined)[0, 9:], s.prior.beta_covariance.diagonal().sqrt(), rtol=1e-4, atol=0)
    assert (std(refined)[:, :3] > 1e3).all()


@each_backend
def test_single_precision(backend) -> None:
    s = scene(CRANE, noise=1.0)
    exact = s.refine(RefinementConfig(backend=backend))
    s.prior.float()
    rough = Refiner(s.prior, s.limits.float(), RefinementConfig(backend=backend))(
        Targets(s.targets.keypoints.float(), s.targets.weights.float()),
        State(s.start.beta.float(), s.start.joint_states.float(), s.start.T_camera_base.float()),
    )
    assert rough.state.beta.dtype == torch.float32
    assert rough.converged.all()
    doubled = State(rough.state.beta.double(), rough.state.joint_states.double(), rough.state.T_camera_base.double())
    assert error(doubled, exact.state).max() < 2e-3


def test_wrong_input_is_named() -> None:
    s = scene(CRANE, batch=2)
    with pytest.raises(InputError, match=r"initial\.beta.*\(2, 8\)"):
        replace(s, start=replace(s.start, beta=s.start.beta[:, :5])).refine(EXACT)
    with pytest.raises(InputError, match=r"targets\.weights: "):
        replace(s, targets=replace(s.targets, weights=-s.targets.weights)).refine(EXACT)
    with pytest.raises(InputError, match=r"targets\.keypoints: "):
        replace(s, targets=replace(s.targets, keypoints=s.targets.keypoints.float())).refine(EXACT)
    with pytest.raises(InputError, match="limits"):
        replace(s, limits=s.limits[:1]).refine(EXACT)
    with pytest.raises(InputError, match="hold_states"):
        free_directions(3, 8, hold_states=(True,))


@pytest.mark.slow
@pytest.mark.parametrize("category", [LAPTOP, DRAWER, CRANE], ids=lambda c: c.name)
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


@pytest.mark.parametrize(
    ("settings", "said"), [({"backend": "cuda"}, "auto or torch or kernel"), ({"huber": 0.0}, "above 0, or None"),
                           ({"huber": float("nan")}, "above 0, or None"), ({"prior_weight": -1.0}, "0, or a number"),
                           ({"prior_weight": np.inf}, "above it"), ({"limit_sigma": 0.0}, "above 0"),
                           ({"limit_sigma": np.nan}, "above 0")]
)  # fmt: skip
def test_settings_that_are_none_are_refused(settings, said):
    with pytest.raises(InputError, match=f"RefinementConfig: {next(iter(settings))} is .*; give .*{said}"):
        RefinementConfig(**settings)
