"""One word for one thing in all commands, and help, defaults and refusals that use it."""

import dataclasses
import typing
from collections import defaultdict
from itertools import pairwise
from pathlib import Path

import pytest

from helpers.command_line import LAPTOP, K, answer, refused, save_png
from omad.cli.main import COMMANDS, Group, run
from omad.common.user_cache import VARIABLE, kept_at, user_cache

SYNONYMS = ({"noise", "depth_noise"}, {"workers", "processes", "jobs"}, {"output", "out", "output_dir"})


def options() -> dict[str, dict[str, object]]:
    """By name of an option its default in each command that has it."""
    found: dict[str, dict[str, object]] = defaultdict(dict)

    def walk(command: str, kind: type) -> None:
        hints = typing.get_type_hints(kind)
        for field in dataclasses.fields(kind):
            if dataclasses.is_dataclass(hints[field.name]):
                walk(command, hints[field.name])
            else:
                found[field.name][command] = field.default

    for name, command in COMMANDS.items():
        for part, kind in command.commands.items() if isinstance(command, Group) else [("", command)]:
            walk(f"{name} {part}".strip(), kind)
    return found


def test_one_name_for_one_thing():
    names = set(options())
    for synonyms in SYNONYMS:
        assert len(names & synonyms) == 1


@pytest.mark.parametrize(
    "name", ["split", "seed", "json", "fast", "depth_scale", "mask", "box", "segment", "broken", "world"]
)
def test_defaults_are_the_same_in_every_command(name):
    assert len(set(options()[name].values())) == 1


def test_no_command_leaves_a_cache_in_the_working_directory():
    assert set(options()["cache"].values()) == {None}


def test_the_cache_is_where_users_expect_it(monkeypatch, tmp_path):
    monkeypatch.delenv(VARIABLE)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr("sys.platform", "linux")
    assert user_cache("x") == tmp_path / "omad" / "x"
    assert kept_at(tmp_path, "kind", "name", {"a": "1"}) == tmp_path / "name"
    assert kept_at(None, "kind", "name", {"a": "1"}) != kept_at(None, "kind", "name", {"a": "2"})


@pytest.mark.parametrize("words", [["estimate"], ["track"], ["train", "net"], ["eval", "pose"]], ids=" ".join)
def test_lines_of_help_end_where_they_are_full(words, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    with pytest.raises(SystemExit):
        run([*words, "--help"])
    lines = [line.strip("│") for line in capsys.readouterr().out.splitlines()]
    texts = [line.strip() if line.startswith(" " * 15) else "" for line in lines]
    widest = max(map(len, texts))
    short = [a for a, b in pairwise(texts) if a and b and len(a) + len(b.split()[0]) < widest]
    assert sum(map(bool, texts)) > 20
    assert not short


def test_workers_are_none_or_more(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert "--workers -3" in refused(capsys, "render", *LAPTOP, "--output", "x", "--workers", "-3")


def test_a_refusal_names_the_option_as_it_is_written():
    from omad.data.urdf_import import shapes

    source = Path(str(shapes.__file__)).read_text()
    assert "--missing-meshes skip" in source
    assert "missing_meshes=" not in source


def test_one_category_may_be_given_where_several_may(capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    frame = [save_png("scene.png"), *K]
    for option in ("--category", "--categories"):
        answer(capsys, "detect", *frame, option, "laptop")
    assert "sedan" in refused(capsys, "detect", *frame, "--category", "sedan")
