"""The house is in order: short files, small folders, and no code that asks for a category by its name.

That rooms import downward only is checked by ``make check``.
"""

import ast
import shutil
import subprocess
from pathlib import Path

import pytest

import omad
from omad.objects.builtin import builtin_names

ROOT = Path(omad.__file__).parent
CHECKOUT = Path(__file__).parents[2]
FOLDERS = [path for path in (ROOT, *ROOT.rglob("*")) if path.is_dir() and "__pycache__" not in path.parts]
FILES = sorted(ROOT.rglob("*.py"))


def test_files_stay_short():
    assert not {path.name: n for path in FILES if (n := len(path.read_text().splitlines())) > 400}


def test_folders_stay_small():
    """Of code: specs and weights lie side by side, one a category."""
    kept = ("__pycache__", "__init__.py", "__main__.py", "py.typed")
    counts = {
        str(folder.relative_to(ROOT)): sum(x.name not in kept and x.suffix != ".toml" for x in folder.iterdir())
        for folder in FOLDERS
        if not folder.is_relative_to(ROOT / "model" / "weights")
    }
    assert not {folder: count for folder, count in counts.items() if count > 14}


@pytest.mark.parametrize("room", [path for path in FILES if path.name == "__init__.py"], ids=lambda p: p.parent.name)
def test_every_room_says_what_it_is_for(room):
    assert ast.get_docstring(ast.parse(room.read_text()))


@pytest.mark.slow
def test_no_code_asks_for_a_category_by_name():
    names = set(builtin_names())
    for path in FILES:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Compare | ast.MatchValue):
                asked = {value.value for value in ast.walk(node) if isinstance(value, ast.Constant)}
                assert not asked & names, f"{path.relative_to(ROOT)}:{node.lineno}"


def test_every_benchmark_is_listed():
    folder = CHECKOUT / "benchmarks"
    listed = (folder / "README.md").read_text()
    assert not [path.name for path in folder.glob("*/*.py") if f"`{path.name}`" not in listed]


@pytest.mark.skipif(not (CHECKOUT / ".git").exists() or not shutil.which("git"), reason="no checkout of git's")
def test_what_a_clone_gets_stays_small():
    """Sixty MiB in all; each category's weights, without those of baselines, 2.2 MB."""
    names = subprocess.run(["git", "ls-files", "-z"], cwd=CHECKOUT, capture_output=True, text=True, check=True).stdout
    files = [file for name in names.split("\0") if name and (file := CHECKOUT / name).is_file()]
    assert sum(file.stat().st_size for file in files) <= 60 * 2**20
    weights = ROOT / "model" / "weights"
    for folder in filter(Path.is_dir, weights.iterdir()):
        own = [
            path.stat().st_size
            for path in folder.rglob("*")
            if path.is_file() and not {"ancsh", "siamese"} & {*path.parts}
        ]
        assert sum(own) <= 2.2e6, folder.name
