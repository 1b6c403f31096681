"""Windows neither renames nor removes a file that is open or mapped, and flushes none that may only be read."""

import os
import sys
from pathlib import Path

import pytest

from helpers.command_line import LAPTOP, K, answer, save_png
from helpers.numbered import SPACE, betas, entries, stream
from omad.applications.retrieval.index import ShapeIndex
from omad.applications.retrieval.large import large_index
from omad.applications.retrieval.large.large_index import LargeIndex
from omad.common import files
from omad.common.files import write_atomic, write_text

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="/proc tells what is open")


def in_use(path: str | os.PathLike[str]) -> bool:
    """By this process."""
    name, handles = os.path.realpath(path), Path("/proc/self/fd")
    return f" {name}\n" in Path("/proc/self/maps").read_text() or any(
        os.path.realpath(handle) == name for handle in handles.iterdir()
    )


@pytest.fixture(autouse=True)
def as_on_windows(tmp_path, monkeypatch):
    def refused_in_use(change):
        def checked(*paths, **options):
            for path in paths:
                if in_use(path):
                    raise PermissionError(13, "used by another process", str(path))
            return change(*paths, **options)

        return checked

    def flush(handle: int, flush=os.fsync) -> None:
        os.write(handle, b"")  # refused where it may only be read
        flush(handle)

    for name in ("rename", "replace", "unlink", "remove"):
        monkeypatch.setattr(os, name, refused_in_use(getattr(os, name)))
    monkeypatch.setattr(os, "fsync", flush)
    monkeypatch.setattr(files, "OPEN_STAYS", True)
    monkeypatch.chdir(tmp_path)


def test_files_get_their_names_when_they_are_closed():
    for text in ("first", "second"):
        write_text("told.txt", text)
        assert Path("told.txt").read_text() == text
    with pytest.raises(ZeroDivisionError):
        write_atomic("told.txt", lambda temporary: 1 / 0)
    assert os.listdir() == ["told.txt"]


def test_catalogues_grow_while_they_are_read(monkeypatch):
    pytest.importorskip("faiss")
    monkeypatch.setattr(large_index, "PART_ENTRIES", 700)
    index, reader = LargeIndex.create(Path("large"), SPACE), None
    for last in (1000, 2500, 4000):
        index.add(stream(last, len(index), 500), "numbers")
        reader = reader or LargeIndex.open(Path("large"))
        assert reader.nearest(betas(10), 3)
    assert len(LargeIndex.open(Path("large"))) == 4000
    small = ShapeIndex(SPACE)
    small.add_betas(betas(10), entries(0, 10))
    for _ in range(2):
        small.save(Path("small.npz"))
    assert len(ShapeIndex.load(Path("small.npz"))) == 10


def test_what_commands_write_is_whole(capsys):
    save_png("views/a.png")
    for name in ("out.jsonl", "out.parquet"):
        assert answer(capsys, "bulk", "views", *LAPTOP, *K, "--output", name)["images"] == 1
    for _ in range(2):
        answer(capsys, "estimate", "views/a.png", *LAPTOP, *K, "--output", "estimate")
        answer(capsys, "render", *LAPTOP, "--output", "rendered", "--views", "1", "--objects", "1")
    assert not list(Path().rglob(f"{files.TEMPORARY}*"))
