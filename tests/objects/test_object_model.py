"""Object models at joint states: of whatever kind these are, and refused where they are none of the object's."""

from functools import cache

import numpy as np
import pytest
import torch

from helpers.categories import EYEGLASSES
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
