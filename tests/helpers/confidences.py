"""Confidences that say the same of every answer."""

import numpy as np

from omad.estimation.confidence.model import Confidence, FittedTo
from omad.estimation.confidence.perceptron import Perceptron
from omad.estimation.confidence.signals import JOINT, WITHOUT_SURFACE
from omad.objects.category import Category


def constant(inputs: int, outputs: list[float]) -> Perceptron:
    """(N,) -> always ``outputs``."""
    zeros = (0.0,) * inputs
    hidden, bent = ((0.0,) * (inputs + 1),), ((0.0,),) * len(outputs)
    return Perceptron(zeros, (1.0,) * inputs, hidden, bent, tuple((*zeros, value) for value in outputs))


def always(category: Category, median: float, upper: float, probability: float) -> Confidence:
    """Half the errors of joint states are below ``median`` and 90 % below ``upper``, category units."""
    joints = len(category.joints)
    errors = [np.log(median), np.log(np.expm1(np.log(upper / median)))]
    return Confidence(
        category.name,
        WITHOUT_SURFACE,
        JOINT,
        constant(len(WITHOUT_SURFACE) + len(JOINT) + joints, [float(value) for value in errors]),
        constant(len(WITHOUT_SURFACE) + joints * len(JOINT), [float(np.log(probability / (1 - probability)))]),
        FittedTo("tests", 0, "0"),
    )
