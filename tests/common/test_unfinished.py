"""Files on their way to their names: who may read them, and what becomes of those that killed processes left."""

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


@pytest.mark.skipif(os.name == "nt", reason="Windows has no modes")
def test_files_may_be_read_by_whom_the_umask_lets_which_nobody_touches(tmp_path, monkeypatch):
    before = os.umask(0o027)
    try:
        with monkeypatch.context() as others:
            others.setattr(os, "umask", None)
            write_text(tmp_path / "a.json", "{}")
    finally:
        os.umask(before)
    assert (tmp_path / "a.json").stat().st_mode & 0o777 == 0o640


def test_without_locks_nobody_elses_file_is_taken_away(tmp_path, monkeypatch):
    monkeypatch.setattr(files, "try_lock", lambda handle: None)
    (tmp_path / ".omad-of-another-machine.json").write_text("{")
    write_text(tmp_path / "b.json", "{}")
    assert sorted(os.listdir(tmp_path)) == [".omad-of-another-machine.json", "b.json"]
