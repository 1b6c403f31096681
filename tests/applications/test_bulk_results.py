"""The file of many answers: one run writes it, whatever interrupts that, and it says what was answered."""

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest

import omad
from helpers.command_line import laptop_view
from omad import InputError
from omad.applications.bulk import parquet_images, stream
from omad.applications.bulk.results import Results


@cache
def alone() -> omad.Estimate:
    return omad.Estimator.from_pretrained("laptop", "cpu")(laptop_view().observation())


@pytest.mark.parametrize("rows", [[[1.0, 2.0, 3.0], [4.0]], [[1.0, 2.0, 3.0], None, [4.0, 5.0, 6.0]]])
def test_rows_of_pixels_that_are_not_of_one_length_are_no_image(rows):
    arrow = pytest.importorskip("pyarrow")
    with pytest.raises(InputError, match=r"depth: .*its rows are not of one length"):
        parquet_images._image(arrow.scalar(rows), None, "depth", lambda stored: stored)


def written(path: Path, outcomes: list[stream.Outcome], cut: int) -> list[dict]:
    """Rows of a file whose making was ended after ``cut`` outcomes, in the middle of a line, and gone on with."""
    results = Results.open(path, {"of": "this"})
    list(results.add(outcomes[:cut]))
    assert not path.exists()
    with results.part.open("ab") as file:
        file.write(b'{"name": "half a l')
    with pytest.raises(InputError, match="other inputs or settings"):
        Results.open(path, {"of": "that"})
    results = Results.open(path, {"of": "this"})
    assert (results.done, results.last) == (cut, outcomes[cut - 1].name)
    list(results.add(outcomes[cut:]))
    results.finish()
    assert [file.name for file in path.parent.iterdir()] == [path.name]
    with pytest.raises(InputError, match="is there already"):
        Results.open(path, {"of": "this"})
    if path.suffix == ".jsonl":
        return [json.loads(line) for line in path.read_text().splitlines()]
    return pytest.importorskip("pyarrow.parquet").read_table(path).to_pylist()


def test_two_runs_do_not_write_the_same_results(tmp_path):
    path, outcomes = tmp_path / "results.jsonl", [stream.Outcome(name, None, "it was dark") for name in "abc"]
    early, late = Results.open(path, {}), Results.open(path, {})
    one = iter(early.add(outcomes))
    next(one)
    with pytest.raises(InputError, match="another run is writing"):
        Results.open(path, {})
    with pytest.raises(InputError, match="another run is writing"):
        list(late.add(outcomes))
    list(one)
    with pytest.raises(InputError, match="another run has added rows"):
        list(late.add(outcomes))
    early.finish()
    assert [json.loads(line)["name"] for line in path.read_text().splitlines()] == list("abc")


def test_a_run_that_is_refused_leaves_the_settings_of_the_one_that_writes(tmp_path):
    path, outcomes = tmp_path / "results.jsonl", [stream.Outcome(name, None, "it was dark") for name in "abc"]
    first, second = Results.open(path, {"of": "this"}), Results.open(path, {"of": "that"})  # neither has rows yet
    rows = iter(first.add(outcomes))
    next(rows)
    with pytest.raises(InputError, match="another run is writing"):
        list(second.add(outcomes))
    rows.close()
    with pytest.raises(InputError, match="other inputs or settings"):
        Results.open(path, {"of": "that"})
    assert Results.open(path, {"of": "this"}).done == 1


@pytest.mark.parametrize("suffix", [".jsonl", ".parquet"])
def test_results_go_on_where_they_stopped(tmp_path, suffix):
    if suffix == ".parquet":
        pytest.importorskip("pyarrow")
    outcomes = [stream.Outcome(str(i), alone()) for i in range(2)]
    outcomes.append(stream.Outcome("2", replace(alone(), of_other_hand=True, hand_probability=0.75)))
    outcomes.insert(1, stream.Outcome("bad", None, "it was dark"))
    rows = written(tmp_path / "made" / f"results{suffix}", outcomes, 2)
    assert [row["name"] for row in rows] == ["0", "bad", "1", "2"]
    assert [row["refused"] for row in rows] == [None, "it was dark", None, None]
    promised = alone().to_dict() | {"mirrored": True, "hand_probability": 0.75}
    for key in (
        "category",
        "converged",
        "residual",
        "beta",
        "T_camera_base",
        "base_std",
        "warnings",
        "mirrored",
        "hand_probability",
    ):
        assert rows[3][key] == promised[key], key
    [joint] = rows[3]["joints"]
    assert {key: joint[key] for key in promised["joints"][0]} == promised["joints"][0]
    assert rows[3]["T_camera_part"] == [part["T_camera_part"] for part in promised["parts"]]
