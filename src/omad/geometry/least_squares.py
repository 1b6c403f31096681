"""Batched Levenberg-Marquardt for many small nonlinear least-squares problems at once.

Every problem has its own damping, accepts or rejects its own steps and leaves the batch when it is done, so
a bad problem (even one of NaNs) costs its neighbours nothing. The unknowns may live on a manifold: ``x`` is
any flat description (B, N) of the points, steps are tangent vectors (B, P), ``retract(x, step)`` moves.

Shapes: B problems, R residuals, P unknowns. Any float dtype, any device; one host synchronisation per
iteration. Nothing is differentiated through the solver.
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class Linearisation:
    """Residuals and their derivatives at a point."""

    residuals: Tensor
    """(B, R)."""
    jacobian: Tensor
    """(B, R, P), with respect to the tangent step at zero."""


@dataclass(frozen=True)
class TrustRegionConfig:
    """How far a step may go."""

    initial_damping: float = 1e-3
    """Relative to the diagonal of J^T J: small, because starting values come from a network and are near."""
    max_damping: float = 1e12
    """A problem that still cannot be improved here stops, not converged."""
    diagonal_floor: float = 1e-9
    """Unknowns that hardly count are damped as if their diagonal were this share of the largest."""


@dataclass(frozen=True)
class TerminationConfig:
    """When a problem is done."""

    max_iterations: int = 1000
    """Done after so many steps, converged or not."""
    step_tolerance: float = 1e-6
    """Converged when no unknown moves by more than this in a step (an accepted one, or one hardly damped)."""
    cost_tolerance: float = 1e-12
    """Converged when an accepted step lowers the cost by less than this share of it."""


@dataclass(frozen=True)
class Huber:
    """Robust loss ``rho(s)`` of the squared length s of a group of three residuals: s up to ``scale`` squared, beyond
    it linear in the length."""

    scale: float
    """Length at which a residual starts to count as an outlier, in units of the (weighted) residual."""
    groups: int
    """The first ``3 * groups`` residuals are robust, the others plain squares."""

    def __post_init__(self) -> None:
        if not self.scale > 0:
            raise ValueError(f"huber: scale {self.scale} must be above 0")

    def loss(self, squared: Tensor) -> tuple[Tensor, Tensor]:
        """``rho`` and its derivative, the weight in reweighted least squares, at squared lengths ``squared``."""
        ratio = squared / self.scale**2
        root = ratio.clamp(min=1).sqrt()
        return torch.where(ratio <= 1, squared, self.scale**2 * (2 * root - 1)), 1 / root


@dataclass(frozen=True)
class Solution:
    """What became of each problem."""

    x: Tensor
    """(B, N)."""
    cost: Tensor
    """(B,) sum of squared residuals, robust ones after ``rho``."""
    hessian: Tensor
    """(B, P, P) J^T J at ``x``; its inverse is the covariance where residuals have unit variance."""
    converged: Tensor
    """(B,) bool."""
    iterations: Tensor
    """(B,) steps tried."""


@dataclass(frozen=True)
class NormalEquations:
    """Of B problems at a point."""

    cost: Tensor
    """(B,) sum of squared residuals, robust ones after ``rho``."""
    gradient: Tensor
    """(B, P) J^T r."""
    hessian: Tensor
    """(B, P, P) J^T J."""


def normal_equations(at: Linearisation, robust: Huber | None = None) -> NormalEquations:
    """What a Gauss-Newton step solves; robust residuals are reweighted."""
    r, jacobian = at.residuals, at.jacobian
    cost = r.square()
    if robust is not None:
        count = 3 * robust.groups
        grouped = r[:, :count].unflatten(1, (-1, 3))
        loss, weight = robust.loss(grouped.square().sum(-1))
        cost = torch.cat([loss, cost[:, count:]], 1)
        root = weight.sqrt().repeat_interleave(3, 1)
        root = torch.cat([root, torch.ones_like(r[:, count:])], 1)
        r, jacobian = r * root, jacobian * root[..., None]
    transposed = jacobian.mT
    return NormalEquations(cost.sum(1), (transposed @ r[..., None]).squeeze(-1), transposed @ jacobian)


DEFAULT_TRUST_REGION = TrustRegionConfig()
DEFAULT_TERMINATION = TerminationConfig()


@torch.no_grad()
def minimise(
    linearise: Callable[[Tensor, Tensor], Linearisation],
    x0: Tensor,
    retract: Callable[[Tensor, Tensor, Tensor], Tensor],
    trust_region: TrustRegionConfig = DEFAULT_TRUST_REGION,
    termination: TerminationConfig = DEFAULT_TERMINATION,
    robust: Huber | None = None,
    far: bool = True,
) -> Solution:
    """Minimise the sum of squared residuals of every problem, starting at ``x0`` (B, N).

    ``linearise(x, indices)`` is given the points (b, N) of the problems ``indices`` (b,) of the batch still at
    work; ``retract(x, step, indices)`` moves them by ``step`` (b, P). An unknown whose Jacobian column is zero
    stays exactly where it is. A problem that is not finite at ``x0`` is returned as it came, not converged.

    ``far``: the start may be anywhere. Unknowns are then damped by what they counted most on the way (More, "The
    Levenberg-Marquardt algorithm", 1978), so that a step into a plain, where they hardly count, stays short.
    """
    floor = torch.finfo(x0.dtype).eps
    indices = torch.arange(len(x0), device=x0.device)
    start = normal_equations(linearise(x0, indices), robust)
    x_out, cost_out, hessian_out = x0.clone(), start.cost.clone(), start.hessian.clone()
    converged_out = torch.zeros_like(indices, dtype=torch.bool)
    iterations_out = torch.zeros_like(indices)

    indices = start.cost.isfinite().nonzero().squeeze(1)
    x, cost = x0[indices], start.cost[indices]
    gradient, hessian = start.gradient[indices], start.hessian[indices]
    damping = torch.full_like(cost, trust_region.initial_damping)
    growth = torch.full_like(cost, 2.0)
    steepest = hessian.diagonal(dim1=-2, dim2=-1).clone()
    for iteration in range(1, termination.max_iterations + 1):
        if not len(indices):
            break
        # Damping follows Marquardt's scaling, so radians, lengths and shape parameters need no common unit.
        diagonal = hessian.diagonal(dim1=-2, dim2=-1)
        steepest = steepest.maximum(diagonal) if far else diagonal
        scale = steepest.clamp(min=trust_region.diagonal_floor * diagonal.amax(1, keepdim=True))
        scale = damping[:, None] * torch.where(scale > 0, scale, 1.0)
        factor, failed = torch.linalg.cholesky_ex(hessian + torch.diag_embed(scale))
        step = -torch.cholesky_solve(gradient[..., None], factor).squeeze(-1)
        step = torch.where((failed == 0)[:, None], step, 0.0)

        trial = retract(x, step, indices)
        new = normal_equations(linearise(trial, indices), robust)
        decrease = cost - new.cost
        predicted = (step * (scale * step - gradient)).sum(1)
        accept = (decrease > 0) & (failed == 0)
        # Nielsen's rule (Madsen, Nielsen, Tingleff 2004): damping follows the gain ratio without a jump at a
        # threshold, and grows ever faster while steps fail, so that a bad start costs few evaluations.
        gain = decrease / predicted
        shrink = (1 - (2 * gain - 1) ** 3).clamp(min=1 / 3)
        damped = damping > 1
        damping = damping * torch.where(accept, shrink, growth)
        growth = torch.where(accept, 2.0, 2 * growth)

        still = step.abs().amax(1) < termination.step_tolerance
        small = still | (decrease < termination.cost_tolerance * cost)
        # A rejected step may only mean that rounding hides the last decrease; one that is short because it is
        # damped means nothing.
        unmeasurable = (predicted <= 8 * floor * cost) | (still & ~damped)
        converged = torch.where(accept, small, unmeasurable & (failed == 0))
        stuck = damping > trust_region.max_damping
        # where an unknown no longer counts that did before, the cost is flat, but not at its least
        flat = (hessian.diagonal(dim1=-2, dim2=-1) < trust_region.diagonal_floor * steepest).any(1)
        converged, stuck = converged & ~flat, stuck | converged

        x = torch.where(accept[:, None], trial, x)
        cost = torch.where(accept, new.cost, cost)
        gradient = torch.where(accept[:, None], new.gradient, gradient)
        hessian = torch.where(accept[:, None, None], new.hessian, hessian)

        last = iteration == termination.max_iterations
        stay = (~(converged | stuck)).nonzero().squeeze(1)
        if last or len(stay) < len(indices):
            x_out[indices], cost_out[indices], hessian_out[indices] = x, cost, hessian
            converged_out[indices], iterations_out[indices] = converged, iteration
            indices, x, cost, gradient, hessian = indices[stay], x[stay], cost[stay], gradient[stay], hessian[stay]
            damping, growth, steepest = damping[stay], growth[stay], steepest[stay]
    return Solution(x_out, cost_out, hessian_out, converged_out, iterations_out)
