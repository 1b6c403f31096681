"""Weights at an address: fetched, checked, kept, and refused where they are not safe."""

import hashlib
import json
import shutil
import threading
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path, PureWindowsPath
from typing import ClassVar
from urllib.request import Request

import numpy as np
import pytest

from helpers.command_line import K, answer, laptop_view, save_png
from omad.cli.main import run
from omad.common.errors import InputError
from omad.common.incoming import address_of
from omad.common.user_cache import user_cache
from omad.estimation.estimator import Estimator
from omad.model.storage.fetched import MANIFEST, _Redirects, fetch
from omad.sensing.observation import Observation


class Quiet(SimpleHTTPRequestHandler):
    asked: ClassVar[list[str]] = []

    def log_message(self, *_) -> None:
        self.asked.append(self.path)


@pytest.fixture
def exported(tmp_path, capsys) -> Path:
    """A checkpoint as ``omad export`` writes it."""
    assert run(["export", "--category", "laptop", "--output", str(tmp_path / "laptop")]) == 0
    capsys.readouterr()
    return tmp_path / "laptop"


@pytest.fixture
def server(exported):
    Quiet.asked.clear()
    handler = partial(Quiet, directory=str(exported.parent))
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as serving:
        threading.Thread(target=serving.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{serving.server_port}/laptop"
        serving.shutdown()


def pin(folder: Path) -> str:
    return "#sha256=" + hashlib.sha256((folder / MANIFEST).read_bytes()).hexdigest()


def rewrite(folder: Path, change) -> None:
    manifest = json.loads((folder / MANIFEST).read_text())
    change(manifest["files"])
    (folder / MANIFEST).write_text(json.dumps(manifest))


def test_an_exported_checkpoint_is_complete_alone_and_holds_nothing_else(exported, tmp_path, capsys):
    assert (exported / "prior" / "model.safetensors").is_file()
    (exported / "prior" / "config.json").unlink()
    (exported / "confidence.json").unlink()
    again = tmp_path / "again"
    shutil.copytree(exported, again)
    (again / "confidence.json").write_text("of another one")
    assert run(["export", "--category", "laptop", "--weights", str(exported), "--output", str(again), "--json"]) == 0
    assert "confidence.json" not in json.loads(capsys.readouterr().out)["files"]
    assert not (again / "confidence.json").exists()


def test_fetched_weights_answer_like_the_shipped_ones(server, exported):
    view = laptop_view()
    seen = Observation.from_depth(view.depth, view.camera)
    fetched = Estimator.from_pretrained(server + pin(exported), "cpu")
    assert np.array_equal(fetched(seen).joint_states, Estimator.from_pretrained("laptop", "cpu")(seen).joint_states)
    assert fetched.surfaces is not None
    before = len(Quiet.asked)
    Estimator.from_pretrained(server + pin(exported), "cpu")
    assert len(Quiet.asked) == before  # what is pinned and kept is not asked for again


def test_http_needs_a_checksum_and_the_right_one(server, exported):
    with pytest.raises(InputError, match="https, or add"):
        fetch(server)
    with pytest.raises(InputError, match="not the one with sha256"):
        fetch(server + "#sha256=" + "0" * 64)
    assert not list(user_cache("weights").glob("*/*"))


def test_without_a_home_or_a_folder_to_write_in_the_cure_is_named(exported, tmp_path, monkeypatch):
    pytest.importorskip("fsspec", reason="other file systems are an extra: pip install 'omad[remote]'")
    (tmp_path / "file").touch()
    monkeypatch.setenv("OMAD_CACHE", str(tmp_path / "file" / "cache"))
    with pytest.raises(InputError, match="set OMAD_CACHE"):
        fetch(exported.as_uri())
    for told in ("OMAD_CACHE", "XDG_CACHE_HOME", "HOME"):
        monkeypatch.delenv(told, raising=False)

    def nobody():
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(Path, "home", nobody)
    with pytest.raises(InputError, match=r"home directory.*set OMAD_CACHE"):
        fetch(exported.as_uri())


def test_https_does_not_lead_to_http():
    redirects, asked = _Redirects(), Request("https://a.org/laptop/manifest.json")
    with pytest.raises(InputError, match=r"a\.org.*sends on to http://b\.org"):
        redirects.redirect_request(asked, None, 302, "Found", {}, "http://b.org/manifest.json")
    assert redirects.redirect_request(asked, None, 302, "Found", {}, "https://b.org/manifest.json") is not None


def test_any_file_system_of_fsspec(exported):
    fsspec = pytest.importorskip("fsspec", reason="other file systems are an extra: pip install 'omad[remote]'")
    memory = fsspec.filesystem("memory")
    memory.put(str(exported), "/weights/laptop", recursive=True)
    assert (fetch("memory://weights/laptop") / "model.safetensors").is_file()
    folder = fetch(exported.as_uri())
    assert (folder / "model.safetensors").read_bytes() == (exported / "model.safetensors").read_bytes()
    shutil.rmtree(exported)
    assert fetch(exported.as_uri()) == folder  # out of reach: what is kept is used


def test_what_a_file_system_lacks_is_no_fault_of_the_address(monkeypatch):
    fsspec = pytest.importorskip("fsspec", reason="other file systems are an extra: pip install 'omad[remote]'")

    def lacking(*_):
        raise ImportError("Install s3fs to access S3")

    monkeypatch.setattr(fsspec, "open", lacking)
    with pytest.raises(InputError, match=r"Install s3fs to access S3\); install what it asks for with pip$"):
        fetch("s3://bucket/laptop")


def test_an_update_that_is_cut_short_leaves_what_was_there(exported):
    pytest.importorskip("fsspec", reason="other file systems are an extra: pip install 'omad[remote]'")
    folder = fetch(exported.as_uri())
    before = {path.name: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    config = exported / "config.json"
    config.write_text(config.read_text() + " ")
    rewrite(exported, lambda files: files["config.json"].update(
        sha256=hashlib.sha256(config.read_bytes()).hexdigest(), bytes=config.stat().st_size
    ))  # fmt: skip
    (exported / "model.safetensors").rename(exported / "away")
    with pytest.raises(InputError, match=r"model\.safetensors"):
        fetch(exported.as_uri())
    assert {path.name: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before
    (exported / "away").rename(exported / "model.safetensors")
    assert (fetch(exported.as_uri()) / "config.json").read_bytes() == config.read_bytes()


def test_a_damaged_file_is_refused(exported):
    damaged = bytearray((exported / "model.safetensors").read_bytes())
    damaged[-1] ^= 1
    (exported / "model.safetensors").write_bytes(damaged)
    with pytest.raises(InputError, match="SHA-256 differs"):
        fetch(exported.as_uri())
    with pytest.raises(InputError, match="SHA-256 differs"):  # nor is half of it kept for the next time
        fetch(exported.as_uri())


@pytest.mark.parametrize("name", ["../x.json", "/etc/x.json", "model.pt", "a/../../x.json", "x.json\0", "C:\\x.json"])
def test_files_that_a_checkpoint_has_not_are_refused(exported, name):
    rewrite(exported, lambda files: files.update({name: {"sha256": "0" * 64, "bytes": 1}}))
    with pytest.raises(InputError, match="is no file of a checkpoint"):
        fetch(exported.as_uri())


@pytest.mark.parametrize(
    "change",
    [lambda files: files.clear(), lambda files: files["config.json"].update(sha256="x"),
     lambda files: files["config.json"].update(bytes=10**15), lambda files: files["config.json"].update(bytes="1")],
    ids=["empty", "no sum", "huge", "text"],
)  # fmt: skip
def test_odd_manifests_are_refused(exported, change):
    rewrite(exported, change)
    with pytest.raises(InputError, match=MANIFEST):
        fetch(exported.as_uri())


def test_what_is_no_checkpoint_is_refused_in_a_line(tmp_path, capsys):
    (tmp_path / MANIFEST).write_text("no")
    for address in (tmp_path.as_uri(), f"{tmp_path.as_uri()}/none", "nosuch://x/y"):
        with pytest.raises(InputError, match=r"^\S+: .*; \w+"):
            fetch(address)


def test_the_command_line_takes_addresses(exported, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    found = answer(capsys, "estimate", save_png("d.png"), "--category", "laptop", "--weights", exported.as_uri(), *K)
    assert abs(found["joints"][0]["state"] - laptop_view().states[0]) < 0.1


def test_addresses_are_told_from_folders():
    assert address_of("laptop") is None
    assert address_of(Path("/a/b")) is None
    assert address_of("C:/weights") is None
    assert address_of(PureWindowsPath("C:/weights")) is None
    assert address_of(PureWindowsPath("s3://bucket/some/weights")) == "s3://bucket/some/weights"
    assert address_of(Path("https://a/b")) == address_of("HTTPS://a/b") == "https://a/b"
    assert address_of(Path("file:///a/b")) == address_of("file:///a/b") == "file:///a/b"
