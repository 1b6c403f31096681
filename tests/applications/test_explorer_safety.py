"""Who may drive the explorer, which files it reads for them, and what it tells of them."""

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

from helpers.command_line import K, save_png
from omad.applications.explorer.fitting import FitRequest
from omad.applications.explorer.places import Places, plain_name
from omad.cli.explore import free_port
from omad.common.errors import InputError
from omad.estimation.estimator import Estimator
from omad.sensing.camera_files import read_camera, read_transform

VISER = pytest.importorskip("viser", reason="needs viser: pip install 'omad[explore]'")
SECRET = "hunter2:x:0:0"


@pytest.fixture(scope="module")
def address():
    from omad.applications.explorer.gate import start_server

    port = free_port("127.0.0.1", 0)
    server = start_server("127.0.0.1", port, "OMAD")
    yield f"127.0.0.1:{server.get_port()}"
    server.stop()


def asked(address: str, host: str | None = None, origin: str | None = None, socket: bool = True) -> int:
    """The status of the answer to a request, as a browser makes it for a page of this origin."""
    import socket as sockets

    lines = ["GET / HTTP/1.1", f"Host: {host or address}"]
    lines += [] if origin is None else [f"Origin: {origin}"]
    key = "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ=="
    protocol = f"Sec-WebSocket-Protocol: viser-v{VISER.__version__}"
    lines += ["Upgrade: websocket", "Connection: Upgrade", key, "Sec-WebSocket-Version: 13", protocol] * socket
    name, port = address.split(":")
    with sockets.create_connection((name, int(port)), timeout=20) as connection:
        connection.sendall("\r\n".join([*lines, "", ""]).encode())
        return int(connection.recv(64).split()[1])


def test_its_own_page_is_served(address):
    port = address.split(":")[1]
    assert asked(address, socket=False) == 200
    assert asked(address, origin=f"http://{address}") == 101
    assert asked(address, f"localhost:{port}", f"http://localhost:{port}") == 101


@pytest.mark.parametrize("origin", [None, "null", "http://evil.example", "http://127.0.0.1:1", "http://127.0.0.1", ""])
def test_a_strangers_page_is_not(address, origin):
    assert asked(address, origin=origin) == 403


def test_a_strangers_name_for_this_machine_is_refused(address):
    """As when a page's own name was made to point here after it was loaded."""
    port = address.split(":")[1]
    name = f"evil.example:{port}"
    assert asked(address, name, f"http://{name}") == 403
    assert asked(address, name, socket=False) == 403
    assert asked(address, f"127.0.0.1.evil.example:{port}", socket=False) == 403


@pytest.fixture
def files(tmp_path, monkeypatch) -> Places:
    monkeypatch.chdir(tmp_path)
    save_png("given/depth.png")
    Path("private").mkdir()
    for name in ("secret.txt", "secret.yaml", "secret.json"):
        Path("private", name).write_text(f"{SECRET}\nmore: [")
    Path("given/link").symlink_to(tmp_path / "private")
    return Places((tmp_path / "given",))


@pytest.mark.parametrize(
    "name",
    ["private/secret.txt", "given/../private/secret.txt", "private/none", "given/link/secret.txt", "/etc/passwd", "~/x",
     "given/../../" * 20, "a\0b", "x" * 5000, "~nobodyatall/x"],
)  # fmt: skip
def test_the_page_reads_below_the_given_folder_alone(files, name):
    """And says the same of files that are there and that are not."""
    texts = ["given/depth.png", K[1], "", "", False, ""]
    for place in (0, 1, 2):
        asked = [*texts[:place], name, *texts[place + 1 :]]
        with pytest.raises(InputError, match="not in the folder") as caught:
            FitRequest.of_texts(*asked, files)
        assert len(str(caught.value)) < 400


def test_files_given_at_start_can_be_fitted_again(files):
    texts = ("given/depth.png", "private/secret.txt", "", "", False, "")
    places = Places((), (Path("given/depth.png"), Path("private/secret.txt")))
    assert FitRequest.of_texts(*texts, places).file == Path("given/depth.png")
    with pytest.raises(InputError, match="not in the folder"):
        FitRequest.of_texts("private/secret.yaml", *texts[1:], places)


@pytest.mark.parametrize("name", ["secret.txt", "secret.yaml", "secret.json"])
def test_errors_do_not_quote_what_is_in_a_file(files, name):
    for read in (read_camera, lambda path: read_transform(path, "T_color_depth")):
        with pytest.raises(InputError, match=name) as caught:
            read(Path("private", name))
        assert "hunter2" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "plain"),
    [("one.png", "one.png"), ("..", "file"), ("../../a.png", "a.png"), ("C:\\b.ply", "b.ply"), ("", "file"),
     (".bashrc", "bashrc"), ("a\0b.png", "a_b.png"), ("x" * 300 + ".png", "x" * 96 + ".png")],
)  # fmt: skip
def test_uploads_are_called_by_plain_names(name, plain):
    assert plain_name(name) == plain


def test_an_uploaded_image_does_not_replace_a_mask_of_its_name(monkeypatch):
    """As a depth image and its mask are called in most data sets."""
    from omad.applications.explorer.gate import start_server
    from omad.applications.explorer.page import ExplorerPage

    server, uploaded = start_server("127.0.0.1", free_port("127.0.0.1", 0), "OMAD"), dict[str, Callable]()
    button = lambda label: SimpleNamespace(on_upload=lambda act: uploaded.update({label: act}))  # noqa: E731
    monkeypatch.setattr(server.gui, "add_upload_button", button)
    with contextlib.closing(ExplorerPage(server, Estimator.from_pretrained("laptop", "cpu"), 1, 0)) as page:
        for label, content in (("Upload mask", b"a mask"), ("Upload a file and fit it", b"an image")):
            file = SimpleNamespace(name="1.png", content=content)
            uploaded[label](SimpleNamespace(client=None, target=SimpleNamespace(value=file)))
        assert Path(page.mask.value).read_bytes() == b"a mask"
        assert Path(page.path.value).read_bytes() == b"an image"
    server.stop()


@pytest.mark.slow
def test_uploads_go_when_the_program_is_terminated(tmp_path):
    command = [sys.executable, "-m", "omad", "explore", "laptop", "--port", "0"]
    served = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env={**os.environ, "TMPDIR": str(tmp_path)}
    )
    assert served.stderr is not None
    next(line for line in served.stderr if line.startswith("omad: http"))
    assert list(tmp_path.glob("omad-explore-*"))
    served.send_signal(signal.SIGTERM)
    _, err = served.communicate(timeout=60)
    assert "Traceback" not in err
    assert not list(tmp_path.glob("omad-explore-*"))
