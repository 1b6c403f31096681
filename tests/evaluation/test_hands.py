"""The log-odds of a hand, against a logistic regression by another optimiser, and against what was drawn."""

import numpy as np
from scipy.optimize import minimize

from omad.evaluation.confidence.hands import DECAY, logistic


def test_it_is_the_regression_with_small_weights():
    rng = np.random.default_rng(0)
    inputs = rng.normal([1.0, -2.0, 0.0], [1.0, 3.0, 0.1], (400, 3))
    true = rng.random(400) < 1 / (1 + np.exp(-(1.5 * (inputs[:, 0] - 1) - 0.5 * (inputs[:, 1] + 2) + 0.3)))
    x = np.column_stack([(inputs - inputs.mean(0)) / inputs.std(0), np.ones(400)])

    def cost(weights):
        likely = 1 / (1 + np.exp(-x @ weights))
        return -np.log(np.where(true, likely, 1 - likely)).mean() + DECAY * np.square(weights).sum()

    wanted = (
        x
        @ minimize(cost, np.zeros(4), method="Nelder-Mead", options={"xatol": 1e-8, "fatol": 1e-12, "maxiter": 9999}).x
    )
    found = logistic(inputs, true)
    np.testing.assert_allclose(inputs @ found[:-1] + found[-1], wanted, atol=1e-3)


def test_what_never_differs_says_nothing():
    inputs = np.column_stack([np.ones(50), np.linspace(-1, 1, 50)])
    found = logistic(inputs, inputs[:, 1] > 0)
    assert found[0] == 0
    assert found[1] > 0
