"""Long work is kept as it comes: a run that was stopped goes on where it was, and nothing is mixed."""

import re
from collections.abc import Iterator

import numpy as np
import pytest

import omad.evaluation.retrieval.shards as shards
from helpers.categories import LAPTOP
from omad.common.errors import InputError
from omad.data.procedural import generate
from omad.data.rendering.standard_views import standard_views
from omad.data.source import load_views
from omad.evaluation.retrieval.shards import described_in_shards

MADE_OF = {"data": "a", "weights": "b"}


@pytest.fixture(autouse=True)
def small(monkeypatch):
    monkeypatch.setattr(shards, "BATCH", 2)
    monkeypatch.setattr(shards, "SHARD", 4)


class Source:
    """Views that are numbers; counts how many were asked for, and breaks off where told."""

    def __init__(self, total: int, breaks_at: int | None = None) -> None:
        self.total, self.breaks_at, self.given = total, breaks_at, []

    def __call__(self, skip: int) -> Iterator[int]:
        for number in range(skip, self.total):
            if number == self.breaks_at:
                raise KeyboardInterrupt
            self.given.append(number)
            yield number


def describe(views: list[int]) -> dict[str, np.ndarray]:
    return {"square": np.square(views), "name": np.array([f"view {number}" for number in views])}


@pytest.mark.parametrize("total", [1, 4, 11])
def test_all_views_in_their_order(tmp_path, total):
    source = Source(total)
    found = described_in_shards(tmp_path, MADE_OF, total, source, describe)
    np.testing.assert_array_equal(found["square"], np.arange(total) ** 2)
    assert found["name"][-1] == f"view {total - 1}"
    again = described_in_shards(tmp_path, MADE_OF, total, Source(total, breaks_at=0), describe)
    np.testing.assert_array_equal(again["square"], found["square"])


def test_a_stopped_run_goes_on_where_it_was(tmp_path):
    with pytest.raises(KeyboardInterrupt):
        described_in_shards(tmp_path, MADE_OF, 11, Source(11, breaks_at=7), describe)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["0000.npz"]
    rest = Source(11)
    found = described_in_shards(tmp_path, MADE_OF, 11, rest, describe)
    assert rest.given == list(range(4, 11))
    np.testing.assert_array_equal(found["square"], np.arange(11) ** 2)


def test_a_source_may_hold_fewer_views_than_it_says(tmp_path):
    for _ in range(2):
        assert len(described_in_shards(tmp_path, MADE_OF, 9, Source(6), describe)["square"]) == 6
    with pytest.raises(InputError, match="empty"):
        described_in_shards(tmp_path / "empty", MADE_OF, 9, Source(0), describe)


def test_other_weights_are_refused_and_a_damaged_file_is_named(tmp_path):
    described_in_shards(tmp_path, MADE_OF, 6, Source(6), describe)
    with pytest.raises(InputError, match=re.escape(str(tmp_path))):
        described_in_shards(tmp_path, MADE_OF | {"weights": "c"}, 6, Source(6), describe)
    (tmp_path / "0001.npz").write_bytes(b"nonsense")
    with pytest.raises(InputError, match=r"0001\.npz"):
        described_in_shards(tmp_path, MADE_OF, 6, Source(6), describe)


def test_skipped_views_are_the_first_ones():
    models = [generate(LAPTOP, index, "test") for index in range(2)]
    every = list(standard_views(models, LAPTOP, 5, 3))
    rest = load_views("procedural", LAPTOP, 2, 5, 0, "off", "refuse", skip=3)
    assert rest.total == 5
    for view, same in zip(rest.views, standard_views(models, LAPTOP, 5, 0, skip=3), strict=True):
        assert view.seed == same.seed
    assert [view.seed for view in standard_views(models, LAPTOP, 5, 3, skip=3)] == [view.seed for view in every[3:]]
