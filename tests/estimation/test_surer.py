"""Which answers from turned frames count: the surest, and on its head only if it is surer by far."""

import pytest
import torch

from omad.estimation.looks.turned import HALF_TURNS, SURER, SURER_INVERTED, surer

UPRIGHT = torch.diag(torch.tensor([1.0, -1.0, -1.0, 1.0]))
"""Up is up in the image, whose y points down."""


@pytest.mark.parametrize("upright", [True, False])
def test_only_a_much_surer_one_stands_an_object_on_its_head(upright):
    found = UPRIGHT if upright else UPRIGHT @ HALF_TURNS[0]
    turned = found @ HALF_TURNS
    on_its_head = [which for which in range(3) if (turned[which, 1, 1] >= 0) and upright]
    for which in range(3):
        needed = SURER_INVERTED if which in on_its_head else SURER
        for expected, taken in ((0.99 * needed, [which]), (1.01 * needed, [])):
            errors = torch.full((3,), 2.0)
            errors[which] = expected * 0.1
            better, best = surer(torch.tensor([0.1]), found[None], errors, turned)
            assert best.tolist() == taken
            assert better.tolist() == [0] * len(taken)


def test_one_that_stands_counts_where_a_surer_one_is_on_its_head():
    found = UPRIGHT[None]
    standing = int(torch.nonzero((UPRIGHT @ HALF_TURNS)[:, 1, 1] < 0)[0, 0])
    errors = torch.full((3,), 0.08 * SURER)
    errors[standing] = 0.09 * SURER
    better, best = surer(torch.tensor([0.1]), found, errors, (UPRIGHT @ HALF_TURNS))
    assert (better.tolist(), best.tolist()) == ([0], [standing])
