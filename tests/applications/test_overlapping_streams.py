"""Streams of estimates beside each other, and of sources that break."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest
import torch

import omad
from helpers.command_line import laptop_view


@pytest.fixture(scope="module")
def estimator() -> omad.Estimator:
    return omad.Estimator.from_pretrained("laptop", "cpu")


@pytest.fixture
def threads() -> Iterator[int]:
    before = torch.get_num_threads()
    torch.set_num_threads(before + 1)
    yield before + 1
    torch.set_num_threads(before)


def test_torch_has_as_many_threads_during_streams_and_after_the_last_as_before_the_first(estimator, threads):
    view = laptop_view().observation()
    first, second = (omad.estimate_stream(estimator, [view] * 3, workers=1, batch=1) for _ in range(2))
    next(first)
    next(second)
    list(first)
    assert torch.get_num_threads() == threads
    with ThreadPoolExecutor(1) as another:  # as servers end what another thread has begun
        another.submit(list, second).result()
        assert another.submit(torch.get_num_threads).result() == threads
    assert torch.get_num_threads() == threads
    with ThreadPoolExecutor(1) as later:
        assert later.submit(torch.get_num_threads).result() == threads


def test_what_came_before_a_source_broke_is_answered(estimator):
    def source() -> Iterator[omad.Observation]:
        for _ in range(7):
            yield laptop_view().observation()
        raise ValueError("the cable is loose")

    stream, found = omad.estimate_stream(estimator, source(), workers=2, batch=2), []
    with pytest.raises(ValueError, match="the cable is loose"):
        found.extend(stream)
    assert [outcome.name for outcome in found] == [str(i) for i in range(7)]
    assert all(outcome.estimate is not None for outcome in found)
