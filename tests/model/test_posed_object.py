"""Objects in compiled loops are those of the plain tensor version."""

from __future__ import annotations

import numpy as np
import pytest

from helpers.scenes import CASES, scene
from omad.model.fitting.posed_object import PosedObject, Poser, posed_objects
from omad.objects.category import Category


def numbers(posed: PosedObject) -> dict[str, np.ndarray]:
    values = vars(posed) | vars(posed.placed)
    return {name: value for name, value in values.items() if name != "placed"}


@pytest.mark.parametrize("category", CASES, ids=lambda c: c.name)
def test_compiled_objects_are_the_plain_ones(category: Category) -> None:
    s = scene(category, batch=5)
    plain, compiled = posed_objects(s.prior, category, s.start), Poser(s.prior, category)(s.start)
    assert len(compiled) == len(plain) == 5
    for ours, reference in zip(compiled, plain, strict=True):
        expected = numbers(reference)
        for name, value in numbers(ours).items():
            np.testing.assert_allclose(value, expected[name], atol=1e-12, err_msg=name)
