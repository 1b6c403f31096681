"""The solver on the certified problems of NIST's Statistical Reference Datasets, from both starts, with defaults."""

import pytest
from torch import Tensor

from helpers.nist import KNOWN, MODELS, Regression
from omad.geometry.least_squares import minimise

UNSOLVED = {("BoxBOD", 0), ("MGH10", 0)}
"""From these starts it ends elsewhere, and says so."""


def add(x: Tensor, step: Tensor, indices: Tensor) -> Tensor:
    return x + step


def test_all_problems_are_there() -> None:
    assert sorted(KNOWN) == sorted(MODELS)
    assert len(MODELS) == 27


@pytest.mark.parametrize("name", MODELS)
def test_the_certified_answer_is_the_least_of_the_model(name: str) -> None:
    """That data and models are NIST's."""
    problem = Regression(name)
    cost = float(problem(problem.certified[None], None).residuals.square().sum())  # pyright: ignore[reportArgumentType]
    assert cost == pytest.approx(KNOWN[name]["cost"], rel=1e-6, abs=1e-20)


@pytest.mark.parametrize("name", MODELS)
def test_four_digits_are_right_or_it_is_not_called_converged(name: str) -> None:
    problem = Regression(name)
    found = minimise(problem, problem.starts, add)
    for start, (digits, converged) in enumerate(zip(problem.digits(found.x), found.converged, strict=True)):
        assert bool(digits >= 4) == bool(converged) == ((name, start) not in UNSOLVED)
