"""The solver on problems that have nothing to do with articulated objects."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.optimize
import torch
from torch import Tensor

from omad.geometry.least_squares import Huber, Linearisation, Solution, TerminationConfig, minimise

TIGHT = TerminationConfig(max_iterations=200, step_tolerance=1e-11, cost_tolerance=0.0)
TIMES = torch.linspace(0, 2, 12, dtype=torch.float64)


def add(x: Tensor, step: Tensor, indices: Tensor) -> Tensor:
    return x + step


class Decay:
    """Fit y = a exp(-k t) + c: residuals (b, 12), unknowns (a, k, c)."""

    def __init__(self, measured: Tensor) -> None:
        self.measured = measured

    def __call__(self, x: Tensor, indices: Tensor) -> Linearisation:
        a, k, c = (x[:, i, None] for i in range(3))
        t = TIMES.to(x.dtype)
        fall = (-k * t).exp()
        jacobian = torch.stack([fall, -a * t * fall, torch.ones_like(fall)], -1)
        return Linearisation(a * fall + c - self.measured[indices], jacobian)


def decays(batch: int, noise: float = 0.05, seed: int = 0) -> Decay:
    draw = torch.Generator().manual_seed(seed)
    a, k, c = (torch.rand(3, batch, 1, generator=draw, dtype=torch.float64) + 0.5).unbind()
    clean = a * (-k * TIMES).exp() + c
    return Decay(clean + noise * torch.randn(clean.shape, generator=draw, dtype=torch.float64))


def solve(problem: Decay, start: Tensor | None = None, **options) -> Solution:
    x0 = torch.tensor([1.0, 2.0, 0.0], dtype=torch.float64).expand(len(problem.measured), 3)
    return minimise(problem, x0 if start is None else start, add, **{"termination": TIGHT, **options})


def scipy_optimum(problem: Decay, index: int) -> scipy.optimize.OptimizeResult:
    def at(x: np.ndarray) -> Linearisation:
        return problem(torch.from_numpy(x)[None], torch.tensor([index]))

    return scipy.optimize.least_squares(
        lambda x: at(x).residuals[0].numpy(),
        np.array([1.0, 2.0, 0.0]),
        jac=lambda x: at(x).jacobian[0].numpy(),  # pyright: ignore[reportArgumentType]
        xtol=1e-15,
        ftol=1e-15,
        gtol=1e-15,
    )


def test_finds_the_optimum_that_scipy_finds() -> None:
    problem = decays(8)
    solution = solve(problem)
    assert solution.converged.all()
    for index in range(8):
        reference = scipy_optimum(problem, index)
        np.testing.assert_allclose(solution.x[index].numpy(), reference.x, atol=1e-7)
        assert solution.cost[index].item() == pytest.approx(2 * reference.cost, rel=1e-9)
        np.testing.assert_allclose(solution.hessian[index].numpy(), reference.jac.T @ reference.jac, rtol=1e-5)


def test_a_batch_is_its_problems_one_by_one() -> None:
    problem = decays(20)
    together = solve(problem, termination=TerminationConfig())
    for index in range(20):
        alone = solve(Decay(problem.measured[index : index + 1]), termination=TerminationConfig())
        torch.testing.assert_close(alone.x[0], together.x[index], atol=1e-12, rtol=0)
        assert alone.iterations[0] == together.iterations[index]


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), 1e200])
def test_a_broken_problem_leaves_its_neighbours_alone(bad: float) -> None:
    problem = decays(6)
    clean = solve(problem)
    problem.measured[2] = bad
    beside = solve(problem)
    good = torch.tensor([0, 1, 3, 4, 5])
    assert (beside.x[good] - clean.x[good]).abs().max() < 1e-12
    assert torch.equal(beside.converged[good], clean.converged[good])
    if not np.isfinite(bad):
        assert not beside.converged[2]
        assert torch.equal(beside.x[2], torch.tensor([1.0, 2.0, 0.0], dtype=torch.float64))


def test_jacobian_that_breaks_midway_stops_only_its_own_problem() -> None:
    problem = decays(3)

    def poisoned(x: Tensor, indices: Tensor) -> Linearisation:
        at = problem(x, indices)
        jacobian = torch.where((indices == 1)[:, None, None], torch.nan, at.jacobian)
        return Linearisation(at.residuals, jacobian)

    clean = solve(problem)
    broken = minimise(poisoned, torch.tensor([[1.0, 2.0, 0.0]], dtype=torch.float64).expand(3, 3), add)
    assert broken.converged.tolist() == [True, False, True]
    torch.testing.assert_close(broken.x[[0, 2]], clean.x[[0, 2]], atol=1e-5, rtol=0)
    assert broken.x[1].isfinite().all()


def test_unknown_without_influence_stays_bit_for_bit() -> None:
    problem = decays(4)

    def held(x: Tensor, indices: Tensor) -> Linearisation:
        at = problem(x, indices)
        return Linearisation(at.residuals, at.jacobian * torch.tensor([1.0, 0.0, 1.0], dtype=torch.float64))

    x0 = torch.tensor([1.0, 0.1 + 0.2, 0.0], dtype=torch.float64).expand(4, 3)
    solution = minimise(held, x0, add)
    assert solution.converged.all()
    assert torch.equal(solution.x[:, 1], x0[:, 1])


def test_single_precision() -> None:
    problem = decays(8)
    exact = solve(problem)
    rough = solve(Decay(problem.measured.float()), exact.x.float() + 0.1, termination=TerminationConfig())
    assert rough.x.dtype == torch.float32
    assert rough.converged.all()
    torch.testing.assert_close(rough.x.double(), exact.x, atol=2e-3, rtol=0)


def test_cost_never_rises_and_iterations_are_limited() -> None:
    problem = decays(16)
    start = 4 * torch.randn(16, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    solution = solve(problem, start, termination=TerminationConfig(max_iterations=3))
    assert (solution.cost <= solve(problem, start, termination=TerminationConfig(max_iterations=0)).cost).all()
    assert (solution.iterations <= 3).all()
    assert not solution.converged.all()


def test_robust_loss_is_the_square_near_zero_and_its_weight_the_derivative() -> None:
    squared = torch.tensor([1e-10, 0.1, 1.0, 3.9, 4.1, 50.0], dtype=torch.float64, requires_grad=True)
    loss, weight = Huber(2.0, 1).loss(squared)
    (slope,) = torch.autograd.grad(loss.sum(), squared)
    torch.testing.assert_close(weight, slope)
    assert loss[0].item() == pytest.approx(1e-10, rel=1e-6)
    assert (loss.diff() > 0).all()
    assert loss[-1] < 0.6 * squared[-1]


def test_robust_kernel_survives_outliers_that_move_plain_squares() -> None:
    problem = decays(8, noise=0.0)
    truth = solve(problem).x
    problem.measured[:, 3:6] += 2.0  # one group of three
    start = truth + 0.1
    plain = solve(problem, start)
    robust = solve(problem, start, robust=Huber(0.05, 4))
    error = (robust.x - truth).norm(dim=1)
    assert (error < 0.25 * (plain.x - truth).norm(dim=1)).all()


def test_senseless_scale_is_refused() -> None:
    with pytest.raises(ValueError, match="scale"):
        Huber(0.0, 4)
