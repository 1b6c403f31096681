"""What killed processes left unfinished is taken away, where locks tell that nobody is at it."""

import os

import pytest

from omad.common import files
from omad.common.files import unfinished, write_text


@pytest.fixture(autouse=True)
def for_the_first_time():
    files._sweep.cache_clear()


def test_what_a_killed_process_left_is_taken_away_and_what_is_written_is_not(tmp_path):
    (tmp_path / ".omad-left.json").write_text("{")
    with unfinished(tmp_path / "a.json") as at_work:
        files._sweep.cache_clear()
        write_text(tmp_path / "b.json", "{}")
        assert at_work.is_file()
        assert sorted(os.listdir(tmp_path)) == [at_work.name, "b.json"]


def test_without_locks_nobody_elses_file_is_taken_away(tmp_path, monkeypatch):
    monkeypatch.setattr(files, "try_lock", lambda handle: None)
    (tmp_path / ".omad-of-another-machine.json").write_text("{")
    write_text(tmp_path / "b.json", "{}")
    assert sorted(os.listdir(tmp_path)) == [".omad-of-another-machine.json", "b.json"]
