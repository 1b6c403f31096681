"""Every command explains itself at once, and refuses what it does not know."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from helpers.command_line import LAPTOP, refused
from omad import __version__
from omad.cli.main import COMMANDS, Group, run

HEAVY = {"torch", "numpy", "scipy", "numba", "matplotlib", "trimesh", "PIL"}
"""Packages that take long to import."""
ALL = [
    f"{name} {part}".strip()
    for name, command in COMMANDS.items()
    for part in (command.commands if isinstance(command, Group) else [""])
]


@pytest.mark.parametrize("command", ALL)
def test_help_explains_every_option(command, capsys):
    with pytest.raises(SystemExit) as stop:
        run([*command.split(), "--help"])
    assert stop.value.code == 0
    text = " ".join(capsys.readouterr().out.replace("│", " ").split())
    options = [entry for entry in re.split(r" (?=--?[a-z][a-z-]*[ ,])", text) if entry.startswith("--")]
    assert any("--json" in option for option in options)
    silent = [o for o in options if re.fullmatch(r"--[\w-]+( [^ ]+)? (\([^)]*\))", o.strip())]
    assert not silent
    if command in ("demo", "estimate", "eval pose", "eval keypoints", "eval views"):
        assert {"--weights", "--device"} <= {option.split()[0] for option in options}


@pytest.mark.slow
@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["nonsense"],
        ["demo", "--objects", "many"],
        ["estimate", "d.png"],
        ["estimate", "d.png", *LAPTOP, "--segment", "sky"],
    ],
)
def test_wrong_usage_exits_with_two(arguments, capsys):
    with pytest.raises(SystemExit) as stop:
        run(arguments)
    assert stop.value.code == 2
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize(
    "command",
    [
        *["figure keypoints --categories laptop", "train prior --category laptop", "detect d.npy", "demo"],
        *["estimate d.npy --category laptop", "index query d.npy --index i.npz", "generate --category laptop"],
        *["render --category laptop", "export --category laptop", "track d --category laptop"],
    ],
)
def test_a_file_name_for_a_folder_of_output_is_refused(command, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert "picture.png: is the name" in refused(capsys, *command.split(), "--output", "picture.png")
    assert not Path("picture.png").exists()


def test_help_loads_nothing_heavy():
    code = """
import contextlib, functools, inspect, io, sys
from omad.cli.main import parse

inspect.getsource = functools.cache(inspect.getsource)
for command in sys.argv[1:]:
    with contextlib.suppress(SystemExit), contextlib.redirect_stdout(io.StringIO()) as said:
        parse([*command.split(), "--help"])
    print(command, "--help" in said.getvalue(), *sys.modules, sep=",")
"""
    asked = [sys.executable, "-c", code, "", *ALL]
    lines = subprocess.run(asked, capture_output=True, text=True, check=True).stdout.splitlines()
    assert len(lines) == len(ALL) + 1
    for line in lines:
        command, explained, *loaded = line.split(",")
        assert explained == "True", command
        assert not HEAVY & set(loaded), f"omad {command} --help, or one before it"


def test_version(capsys):
    assert run(["--version"]) == 0
    assert capsys.readouterr().out.strip() == __version__


@pytest.mark.skipif(shutil.which("bash") is None, reason="needs a shell that closes streams")
@pytest.mark.parametrize("closed", [">&-", "2>&-", ">&- 2>&-"])
def test_streams_may_be_closed(closed):
    command = ["bash", "-c", f'"{sys.executable}" -m omad --version {closed}']
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
