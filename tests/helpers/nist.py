"""The nonlinear regression problems of NIST's Statistical Reference Datasets (https://www.itl.nist.gov/div898/strd/):
observations, two starts each, and certified answers, which stand in ``golden/nist_strd.json``. Here are the models."""

import json
import math
from collections.abc import Callable
from pathlib import Path

import torch
from torch import Tensor

from omad.geometry.least_squares import Linearisation

KNOWN = json.loads((Path(__file__).parents[1] / "golden" / "nist_strd.json").read_text())
Model = Callable[[Tensor, Tensor], Tensor]


def _waves(b: Tensor, x: Tensor) -> Tensor:
    def wave(cosine: int, period: Tensor | float) -> Tensor:
        angle = 2 * math.pi * x / period
        return b[cosine] * angle.cos() + b[cosine + 1] * angle.sin()

    return b[0] + wave(1, 12) + wave(4, b[3]) + wave(7, b[6])


def _bells(b: Tensor, x: Tensor) -> Tensor:
    bells = (b[k] * (-(((x - b[k + 1]) / b[k + 2]) ** 2)).exp() for k in (2, 5))
    return b[0] * (-b[1] * x).exp() + sum(bells)


def _ratio(above: int) -> Model:
    def model(b: Tensor, x: Tensor) -> Tensor:
        over = sum(b[k] * x**k for k in range(above))
        return over / (1 + sum(b[k] * x ** (k - above + 1) for k in range(above, len(b))))

    return model


MODELS: dict[str, Model] = {
    "Bennett5": lambda b, x: b[0] * (b[1] + x) ** (-1 / b[2]),
    "BoxBOD": lambda b, x: b[0] * (1 - (-b[1] * x).exp()),
    "Chwirut1": lambda b, x: (-b[0] * x).exp() / (b[1] + b[2] * x),
    "Chwirut2": lambda b, x: (-b[0] * x).exp() / (b[1] + b[2] * x),
    "DanWood": lambda b, x: b[0] * x ** b[1],
    "ENSO": _waves,
    "Eckerle4": lambda b, x: b[0] / b[1] * (-0.5 * ((x - b[2]) / b[1]) ** 2).exp(),
    "Gauss1": _bells,
    "Gauss2": _bells,
    "Gauss3": _bells,
    "Hahn1": _ratio(4),
    "Kirby2": _ratio(3),
    "Lanczos1": lambda b, x: sum(b[k] * (-b[k + 1] * x).exp() for k in (0, 2, 4)),
    "Lanczos2": lambda b, x: sum(b[k] * (-b[k + 1] * x).exp() for k in (0, 2, 4)),
    "Lanczos3": lambda b, x: sum(b[k] * (-b[k + 1] * x).exp() for k in (0, 2, 4)),
    "MGH09": lambda b, x: b[0] * (x**2 + x * b[1]) / (x**2 + x * b[2] + b[3]),
    "MGH10": lambda b, x: b[0] * (b[1] / (x + b[2])).exp(),
    "MGH17": lambda b, x: b[0] + b[1] * (-x * b[3]).exp() + b[2] * (-x * b[4]).exp(),
    "Misra1a": lambda b, x: b[0] * (1 - (-b[1] * x).exp()),
    "Misra1b": lambda b, x: b[0] * (1 - (1 + b[1] * x / 2) ** -2),
    "Misra1c": lambda b, x: b[0] * (1 - (1 + 2 * b[1] * x) ** -0.5),
    "Misra1d": lambda b, x: b[0] * b[1] * x / (1 + b[1] * x),
    "Nelson": lambda b, x: b[0] - b[1] * x[0] * (-b[2] * x[1]).exp(),
    "Rat42": lambda b, x: b[0] / (1 + (b[1] - b[2] * x).exp()),
    "Rat43": lambda b, x: b[0] / (1 + (b[1] - b[2] * x).exp()) ** (1 / b[3]),
    "Roszman1": lambda b, x: b[0] - b[1] * x - (b[2] / (x - b[3])).atan() / math.pi,
    "Thurber": _ratio(4),
}


class Regression:
    """One of the problems, for the solver: unknowns (b, P)."""

    def __init__(self, name: str) -> None:
        known = KNOWN[name]
        self.starts, self.certified = (torch.tensor(known[key], dtype=torch.float64) for key in ("starts", "certified"))
        x, y = (torch.tensor(known[key], dtype=torch.float64) for key in ("x", "y"))
        y = y.log() if name == "Nelson" else y

        def residuals(b: Tensor) -> Tensor:
            return MODELS[name](b, x) - y

        self._residuals, self._jacobian = torch.vmap(residuals), torch.vmap(torch.func.jacfwd(residuals))

    def __call__(self, x: Tensor, indices: Tensor) -> Linearisation:
        return Linearisation(self._residuals(x), self._jacobian(x))

    def digits(self, x: Tensor) -> Tensor:
        """(b,) significant digits of the worst unknown."""
        return -((x - self.certified) / self.certified).abs().amax(1).clamp(min=1e-12).log10().nan_to_num(nan=1.0)
