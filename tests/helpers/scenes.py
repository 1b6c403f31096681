"""Random, well-conditioned fitting problems whose truth is known."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from helpers.categories import CATEGORIES
from omad.geometry.transforms import make_transform, so3_exp
from omad.model.fitting.energy import RefinementConfig
from omad.model.fitting.refinement import Refiner
from omad.model.fitting.state import Refined, State, Targets
from omad.model.prior import OmadPrior
from omad.objects.category import Category, JointSpec, PartSpec

CRANE = Category(
    name="crane",
    metres_per_unit=1.0,
    parts=(PartSpec("foot", 6), PartSpec("mast", 6), PartSpec("boom", 8), PartSpec("hook", 7)),
    joints=(
        JointSpec("slew", "revolute", 0, (0.0, 1.0, 0.0), (-1.5, 1.5)),
        JointSpec("reach", "prismatic", 1, (1.0, 0.0, 0.0), (-0.6, 0.6)),
        JointSpec("tilt", "revolute", 2, (0.0, 0.0, 1.0), (-1.2, 1.2)),
    ),
    basis_size=8,
)
"""Three joints in a row, one of them prismatic."""
VICE = Category(
    name="vice",
    metres_per_unit=0.5,
    parts=(PartSpec("bench", 6), PartSpec("jaw", 6), PartSpec("bar", 6)),
    joints=(
        JointSpec("spindle", "screw", 0, (0.0, 0.0, 1.0), (-1.5, 1.5), pitch=-0.9),
        JointSpec("slide", "prismatic", 1, (1.0, 0.0, 0.0), (-0.6, 0.6)),
    ),
    basis_size=8,
)
"""A joint that turns and slides, and one that hangs on it."""
CASES = (*CATEGORIES.values(), CRANE, VICE)
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
        return Refiner(self.prior, self.limits, config, free)(self.targets, self.start)


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


def scene(category: Category, batch: int = 12, noise: float = 0.0, seed: int = 0, loose: int = 0) -> Scene:
    """``loose``: numbers that beta ends in."""
    draw = torch.Generator().manual_seed(seed)

    def normal(*shape: int) -> Tensor:
        return torch.randn(shape, generator=draw, dtype=torch.float64)

    prior = random_prior(category, draw)
    if loose:
        prior.loosen(0.05 * normal(len(category.joints), 3, loose))
    root = torch.linalg.cholesky(prior.beta_covariance)
    beta = prior.beta_mean + normal(batch, prior.basis_size) @ root.T
    limits = torch.as_tensor(category.limits)
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
