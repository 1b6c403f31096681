"""Generators of one's own: they take the place of models, and what is wrong in them is said with its line."""

import sys
from pathlib import Path

import numpy as np
import pytest

import omad
from helpers.command_line import answer, refused
from helpers.travel import deepest_cut
from omad.cli.main import run
from omad.common.errors import InputError
from omad.data.procedural.own import own_generator
from omad.data.source import load_models

DOCS = Path(__file__).parents[2] / "docs"
SPEC, GENERATOR = DOCS / "categories" / "mailbox.toml", DOCS / "categories" / "mailbox.py"
MAILBOX = omad.get_category(SPEC)


def test_the_example_is_short_and_stands_in_the_guide():
    text = GENERATOR.read_text()
    assert len(text.splitlines()) < 40
    assert text in (DOCS / "own-category.md").read_text()


def test_its_objects_are_reproducible_closed_and_clear_of_each_other():
    models = [load_models(str(GENERATOR), MAILBOX, 8, "train", 0).models for _ in range(2)]
    for one, again in zip(*models, strict=True):
        assert one.closed
        assert deepest_cut(one, MAILBOX, np.random.default_rng(0)) < 0.01
        for part, same in zip(one.parts, again.parts, strict=True):
            np.testing.assert_array_equal(part.vertices, same.vertices)
    others = load_models(str(GENERATOR), MAILBOX, 8, "test", 0).models
    assert not {model.diagonal for model in models[0]} & {model.diagonal for model in others}


def test_they_are_written_and_imported_by_commands(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    spec = ["--category", str(SPEC)]
    answer(capsys, "generate", *spec, "--source", str(GENERATOR), "--output", "made", "--objects", "3")
    assert len(answer(capsys, "import", "made", *spec, "--output", "seen")["used"]) == 3
    assert run(["generate", *spec, "--source", str(GENERATOR), "--output", "made", "--objects", "1"]) == 0
    assert "made: holds 2 others, mailbox-test-0-00001 say" in capsys.readouterr().err
    answer(capsys, "render", *spec, "--source", str(GENERATOR), "--output", "views", "--objects", "2", "--views", "2")
    other = tmp_path / "mailbox.toml"
    other.write_text(SPEC.read_text() + "\n[views]\nelevation = [80, 89]\n")
    drawn = ["--source", str(GENERATOR), "--output", "views", "--objects", "2", "--views", "4"]
    assert "viewpoints" in refused(capsys, "render", "--category", str(other), *drawn)
    assert "mailbox" in refused(capsys, "generate", *spec, "--output", "none")  # no file is run that was not named


WRONG = {
    "no such file": (None, "no such file"),
    "no Python": ("def generate(:\n", r"own\.py:1: SyntaxError"),
    "no function": ("make = 1\n", "no function generate"),
    "an error": ("def generate(rng, category, unusual):\n    return 1 / 0\n", r"own\.py:2: ZeroDivisionError"),
    "something else": ("def generate(rng, category, unusual):\n    return 7\n", "gives a int"),
    "too few parts": (
        "from omad.data.procedural.vocabulary import JointedParts, box\n\n\ndef generate(rng, category, unusual):\n"
        "    return JointedParts((box((0, 0, 0), (1, 1, 1)),), rng.normal(size=(1, 3)))\n",
        "parts of 1, a mailbox has 2",
    ),
    "parts that are none": (
        "from omad.data.procedural.vocabulary import JointedParts\n\n\ndef generate(rng, category, unusual):\n"
        "    return JointedParts((None, None), rng.normal(size=(1, 3)))\n",
        "parts that are no Mesh",
    ),
    "a mesh in place of all parts": (
        "from omad.data.procedural.vocabulary import JointedParts, box\n\n\ndef generate(rng, category, unusual):\n"
        "    return JointedParts(box((0, 0, 0), (1, 1, 1)), rng.normal(size=(1, 3)))\n",
        "give a tuple of them",
    ),
    "an end of the program": ("import sys\n\nsys.exit()\n", r"own\.py:3: SystemExit"),
    "an end in the middle": ("def generate(rng, category, unusual):\n    raise SystemExit\n", r"own\.py:2: SystemExit"),
    "randomness of its own": (
        "import numpy as np\nfrom omad.data.procedural.vocabulary import JointedParts, box\n\n\n"
        "def generate(rng, category, unusual):\n"
        "    return JointedParts((box((0, 0, 0), np.random.uniform(0.1, 0.2, 3)),) * 2, [[0, 0, 0]])\n",
        "another object for the same rng",
    ),
    "one object that is changed": (
        "from omad.data.procedural.vocabulary import JointedParts, box\n\nPART = box((0, 0, 0), (0.2, 0.2, 0.2))\n\n\n"
        "def generate(rng, category, unusual):\n"
        "    PART.vertices[:] *= rng.uniform(0.9, 1.1)\n"
        "    return JointedParts((PART,) * 2, [[0, 0, 0]])\n",
        "another object for the same rng",
    ),
    "limits of its own randomness": (
        "import numpy as np\nfrom omad.data.procedural.vocabulary import JointedParts, box\n\n\n"
        "def generate(rng, category, unusual):\n"
        "    limits = [[0, np.random.uniform(0.5, 1.5)]]\n"
        "    return JointedParts((box((0, 0, 0), (0.2, 0.2, 0.2)),) * 2, [[0, 0, 0]], limits=limits)\n",
        "another object for the same rng",
    ),
    "pivots of another shape": (
        "from omad.data.procedural.vocabulary import JointedParts, box\n\n\ndef generate(rng, category, unusual):\n"
        "    return JointedParts((box((0, 0, 0), (1, 1, 1)),) * 2, rng.normal(size=3))\n",
        r"pivots of \(3,\), a mailbox has \(1, 3\)",
    ),
}


NUMBERS = {
    "a part of nothing": ("merge_meshes([])", "", "no face of the part"),
    "vertices that are none": ("box((0, 0, 0), (0.1, 0.1, np.nan))", "", "vertices of the part .* no finite numbers"),
    "pivots that are none": (
        "box((0, 0, 0), (0.1, 0.1, 0.1))",
        ", np.full((1, 3), np.nan)",
        "pivots that are no finite",
    ),
    "a vertex of two numbers": ("Mesh(np.zeros((3, 2)), [[0, 1, 2]])", "", "vertices of the part .* three a vertex"),
    "faces of four corners": ("Mesh(np.eye(4, 3), [[0, 1, 2, 3]])", "", "that are no triangles"),
    "faces that are no whole numbers": ("Mesh(np.eye(3), [[0.0, 1.0, 2.0]])", "", "three whole numbers a face"),
    "faces that differ": ("Mesh(np.eye(3), [[0, 1, 2], [0, 1]])", "", "that are no triangles"),
    "a face beyond the vertices": ("Mesh(np.eye(3), [[0, 1, 3]])", "", "vertices that are not there"),
    "a part without an area": ("Mesh(np.zeros((3, 3)), [[0, 1, 2]])", "", "without an area"),
    "limits of another joint": (
        "box((0, 0, 0), (0.1, 0.1, 0.1))",
        ", limits=np.array([[-1.0, -0.5]])",
        "outside of the spec's",
    ),
    "an axis of nothing": ("box((0, 0, 0), (0.1, 0.1, 0.1))", ", axes=np.zeros((1, 3))", "axis without a direction"),
    "limits turned": ("box((0, 0, 0), (0.1, 0.1, 0.1))", ", limits=np.array([[1.0, 0.0]])", "the wrong way round"),
    "limits in few degrees": ("box((0, 0, 0), (0.1, 0.1, 0.1))", ", limits=np.array([[0.0, 20.0]])", "give radians"),
    "limits in degrees": ("box((0, 0, 0), (0.1, 0.1, 0.1))", ", limits=np.array([[0.0, 90.0]])", "give radians"),
    "millimetres": ("box((0, 0, 0), (300, 300, 300))", "", "520 m across, .* give metres"),
}


@pytest.mark.parametrize(("part", "further", "said"), NUMBERS.values(), ids=NUMBERS)
def test_numbers_that_cannot_be_are_said_in_a_line(part, further, said, tmp_path):
    file = tmp_path / "own.py"
    pivots = "" if "pivot" in said else ", np.zeros((1, 3))"
    file.write_text(
        "import numpy as np\nfrom omad.data.procedural.vocabulary import JointedParts, box\n"
        "from omad.geometry.mesh import Mesh, merge_meshes\n\n\ndef generate(rng, category, unusual):\n"
        f"    return JointedParts(({part},) * 2{pivots}{further})\n"
    )
    with pytest.raises(InputError, match=said):
        own_generator(file)(np.random.default_rng(0), MAILBOX, None)


def test_lists_and_axes_of_any_length_are_taken(tmp_path, capsys):
    """And what it prints is no answer of a command."""
    file = tmp_path / "own.py"
    file.write_text(
        "from omad.data.procedural.vocabulary import JointedParts, box\nprint('found')\n\n\n"
        "def generate(rng, category, unusual):\n    print('called')\n"
        "    part = box((0, 0, 0), (0.1, 0.1, 0.1))\n"
        "    return JointedParts((part, part), [[0, 0, 0]], axes=[[2, 0, 0]], limits=[[0, 1]])\n"
    )
    made = own_generator(file)(np.random.default_rng(0), MAILBOX, None)
    np.testing.assert_array_equal(made.axes, [[1.0, 0, 0]])
    np.testing.assert_array_equal(made.limits, [[0.0, 1]])
    assert capsys.readouterr() == ("", "found\ncalled\ncalled\n")


@pytest.mark.parametrize(("text", "said"), WRONG.values(), ids=WRONG)
def test_what_is_wrong_in_one_is_said_in_a_line(text, said, tmp_path):
    file = tmp_path / "own.py"
    if text is not None:
        file.write_text(text)
    with pytest.raises(InputError, match=said) as raised:
        own_generator(file)(np.random.default_rng(0), MAILBOX, None)
    assert "\n" not in str(raised.value)


FAMILIES = {
    "z up": (
        "tuple(mesh.warped(lambda v: v[:, [0, 2, 1]] * [1, -1, 1]) for mesh in made.parts)",
        "",
        "mostly towards [+]z",
    ),
    "the flap first": ("made.parts[::-1]", "", "side says, mostly towards -z"),
    "turned round": ("made.parts", ", axes=[[-1, 0, 0]]", "180 degrees off the spec's"),
    "far from its hinge": ("made.parts", ", pivots=made.pivots + [0, 50, 0]", "reach says, mostly towards -y"),
}


def family(folder: Path, parts: str, further: str) -> str:
    """A generator of what the example makes, with other parts."""
    (folder / "mailbox.py").write_text(GENERATOR.read_text())
    file = folder / "own.py"
    file.write_text(
        "import runpy\nfrom dataclasses import replace\nfrom pathlib import Path\n\n"
        'make = runpy.run_path(str(Path(__file__).with_name("mailbox.py")))["generate"]\n\n\n'
        "def generate(rng, category, unusual):\n    made = make(rng, category, unusual)\n"
        f"    return replace(made, parts={parts}{further})\n"
    )
    return str(file)


@pytest.mark.parametrize(("parts", "further", "said"), FAMILIES.values(), ids=FAMILIES)
def test_a_family_that_lies_otherwise_than_the_spec_says_is_refused(parts, further, said, tmp_path):
    with pytest.raises(InputError, match=rf"4 of 4 objects are no mailbox: .*{said}; mend the generator"):
        load_models(family(tmp_path, parts, further), MAILBOX, 4, "train", 0)


def test_what_lies_beside_it_may_be_imported_whenever_it_runs(tmp_path, monkeypatch):
    monkeypatch.setattr("sys.path", sys.path[:])
    (tmp_path / "beside_it_at_once.py").write_text("GENERATOR = " + repr(str(GENERATOR)))
    (tmp_path / "beside_it_later.py").write_text("import runpy\nrun = runpy.run_path")
    (tmp_path / "own.py").write_text(
        "from beside_it_at_once import GENERATOR\n\n\ndef generate(rng, category, unusual):\n"
        '    from beside_it_later import run\n    return run(GENERATOR)["generate"](rng, category, unusual)\n'
    )
    [model] = load_models(str(tmp_path / "own.py"), MAILBOX, 1, "train", 0).models
    [same] = load_models(str(GENERATOR), MAILBOX, 1, "train", 0).models
    assert model.diagonal == same.diagonal


def test_limits_are_kept_within_those_of_the_spec(tmp_path):
    [model] = load_models(family(tmp_path, "made.parts", ", limits=[[-3, 1]]"), MAILBOX, 1, "train", 0).models
    np.testing.assert_array_equal(model.limits, [[0.0, 1.0]])
