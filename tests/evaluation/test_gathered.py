"""What is worked out a few at a time goes on where it was interrupted."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from omad.cli.training import fitted
from omad.cli.training.fitted import BEGUN, TrainConfidence
from omad.data.procedural import generate
from omad.estimation.confidence.model import FILE
from omad.estimation.estimator import Estimator
from omad.evaluation.confidence import fitting, hands
from omad.evaluation.confidence.gathered import Begun, Rows, gathered
from omad.evaluation.confidence.hands import fit_hand
from omad.model.checkpoint import find_weights

MADE_OF = {"weights": "a", "views": "10"}


class Squares:
    """A row for each number that three does not divide, until there are ``most``."""

    def __init__(self, most: int = 1000) -> None:
        self.made, self.most = list[int](), most

    def __call__(self, indices: range) -> Rows:
        found = [n for n in indices if n % 3]
        if len(self.made) + len(found) > self.most:
            raise InterruptedError
        self.made += found
        return {"n": np.array(found), "square": np.square(found)[:, None]} if found else {}


@pytest.mark.parametrize("size", [1, 2, 4, 64])
def test_as_many_rows_as_asked_for_in_order(size: int) -> None:
    rows = gathered(Squares(), 10, size, "all", None)
    assert rows["n"].tolist() == [1, 2, 4, 5, 7, 8, 10, 11, 13, 14]
    assert rows["square"][:, 0].tolist() == [n * n for n in rows["n"]]


@pytest.mark.parametrize("size", [1, 2, 4])
def test_what_was_interrupted_goes_on(size: int, tmp_path: Path) -> None:
    begun, whole = Begun(tmp_path / "begun", MADE_OF), Squares()
    expected = gathered(whole, 10, size, "all", None)
    first, second, third = Squares(5), Squares(), Squares()
    with pytest.raises(InterruptedError):
        gathered(first, 10, size, "all", begun)
    rows = gathered(second, 10, size, "all", begun)
    assert first.made
    assert second.made
    assert first.made + second.made == whole.made
    again = gathered(third, 10, size, "all", begun)
    assert not third.made
    for found in (rows, again):
        assert all(np.array_equal(found[name], expected[name]) for name in ("n", "square"))
    assert gathered(Squares(), 10, size, "other", begun)["n"].tolist() == expected["n"].tolist()
    begun.end()
    assert not any(tmp_path.iterdir())


def test_what_is_of_other_things_or_damaged_is_made_anew(tmp_path: Path) -> None:
    kept, other, damaged = Squares(), Squares(), Squares()
    gathered(kept, 10, 4, "all", Begun(tmp_path, MADE_OF))
    gathered(other, 10, 4, "all", Begun(tmp_path, MADE_OF | {"weights": "b"}))
    assert other.made == kept.made
    for file in tmp_path.iterdir():
        file.write_bytes(file.read_bytes()[:-40])
    gathered(damaged, 10, 4, "all", Begun(tmp_path, MADE_OF))
    assert damaged.made == kept.made


def test_a_training_of_confidence_that_was_killed_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in (("FEWEST", 10), ("STEPS", 5), ("BATCH", 15)):
        monkeypatch.setattr(fitting, name, value)
    weights = tmp_path / "own"
    weights.mkdir()
    for name in ("config.json", "model.safetensors"):
        shutil.copy(find_weights("laptop") / name, weights / name)
    looked, answers = list[int](), fitting._answers
    monkeypatch.setattr(fitting, "_answers", lambda *given: looked.append(len(given[1])) or answers(*given))
    command, last = TrainConfidence(category="laptop", weights=weights, objects=2, views=24), fitted.fit_shared

    def killed(*_: object) -> float:
        raise InterruptedError

    monkeypatch.setattr(fitted, "fit_shared", killed)
    with pytest.raises(InterruptedError):
        command.run()
    assert sum(looked) == 24
    assert not (weights / FILE).exists()
    assert (weights / BEGUN).is_dir()
    looked.clear()
    monkeypatch.setattr(fitted, "fit_shared", last)
    command.run()
    assert sum(looked) == 6  # to measure on
    assert (weights / FILE).exists()
    assert not (weights / BEGUN).exists()


def test_what_tells_a_hand_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    estimator, begun = Estimator.from_pretrained("microwave", "cpu"), Begun(tmp_path, MADE_OF)
    models = [generate(estimator.category, index, "test") for index in range(2)]
    found = fit_hand(estimator, models, 4, 0, begun)
    monkeypatch.setattr(hands, "_of_each_hand", None)
    assert fit_hand(estimator, models, 4, 0, begun) == found
