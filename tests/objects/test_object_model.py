"""Object models at joint states: of whatever kind these are, and refused where they are none of the object's."""

from functools import cache

import numpy as np
import pytest
import torch

from helpers.categories import EVERY, EYEGLASSES
from helpers.own_models import jar
from omad.common.errors import InputError
from omad.data.procedural import generate
from omad.objects.model import ObjectModel


@cache
def spectacles() -> ObjectModel:
    return generate(EYEGLASSES, 0, "test")


@pytest.mark.parametrize("states", [0.3, [0.3], [0.3, 0.3, 0.3], [[0.3, 0.3]], ["a", "b"], None, [[0.3], [0.3, 0.3]]])
@pytest.mark.parametrize("ask", [ObjectModel.placed, ObjectModel.posed, ObjectModel.part_transforms])
def test_states_that_are_not_one_a_joint_are_refused(ask, states):
    with pytest.raises(InputError, match=r"states: expected finite numbers of shape \(2\)"):
        ask(spectacles(), states)


@pytest.mark.parametrize("form", [list, tuple, torch.tensor, lambda states: torch.tensor(states, requires_grad=True)])
def test_states_are_taken_of_any_kind(form):
    expected = spectacles().part_transforms(np.array([0.25, -0.5]))
    assert np.array_equal(spectacles().part_transforms(form([0.25, -0.5])), expected)
    assert len(np.unique(expected[:, 0, 0])) == 3


OBJECTS = ["laptop", "eyeglasses", "drawer", "jar"]


def made(name: str) -> ObjectModel:
    return jar() if name == "jar" else generate(EVERY[name], 0, "test")


def where(model: ObjectModel, states: np.ndarray) -> np.ndarray:
    return np.concatenate(model.posed_vertices(states))


@pytest.mark.parametrize("share", [0.0, 0.4, 1.0])
@pytest.mark.parametrize("name", OBJECTS)
def test_a_changed_object_moves_as_the_object_does(name, share):
    model = made(name)
    states = model.limits[:, 0] + share * np.ptp(model.limits, axis=1)
    seen = where(model, states)
    assert np.allclose(where(model.mirrored(), states), seen * [-1.0, 1.0, 1.0])
    zero = model.limits.mean(1)
    other = model.with_zero_at(zero)
    assert np.allclose(where(other, states - zero), seen)
    assert np.allclose(other.limits[:, 0] + share * np.ptp(other.limits, axis=1), states - zero)
    away = ObjectModel.centred(other)
    shift = where(away, states - zero) - seen
    assert np.allclose(shift, shift[0])
    assert np.allclose(where(model.stretched(np.full(3, 1.2)), np.zeros(len(states))), 1.2 * where(model, 0 * states))


def test_drawers_of_a_stretched_chest_come_out_as_much_farther():
    model, factors = made("drawer"), np.array([1.0, 0.8, 1.3])
    longer = model.stretched(factors)
    for end in (0, 1):
        assert np.allclose(where(longer, longer.limits[:, end]), where(model, model.limits[:, end]) * factors)
