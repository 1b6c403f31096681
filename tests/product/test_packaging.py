"""What is shipped: a small wheel, others for further categories and baselines, and workflows that publish them."""

import json
import re
import shlex
import subprocess
import sys
import tomllib
import zipfile
from fnmatch import fnmatch
from pathlib import Path

import pytest
import yaml

from helpers.categories import CATEGORIES
from omad import __version__
from omad.cli.main import parse
from omad.cli.scale.serve import Serve

ROOT = Path(__file__).parents[2]
APART = {name: f"packaging/{name}" for name in ("baselines", "categories")}


def built(project: Path, folder: Path) -> zipfile.ZipFile:
    pytest.importorskip("build", reason="pip install build hatchling: no wheel can be built without")
    pytest.importorskip("hatchling", reason="pip install build hatchling: no wheel can be built without")
    command = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(folder), str(project)]
    subprocess.run(command, check=True, capture_output=True)
    [wheel] = folder.glob("*.whl")
    return zipfile.ZipFile(wheel)


@pytest.mark.slow
def test_the_wheel_is_small_and_other_weights_come_apart(tmp_path):
    wheels = [built(ROOT / folder, tmp_path / str(n)) for n, folder in enumerate((".", *APART.values()))]
    assert sum(file.compress_size for file in wheels[0].infolist()) < 20e6
    files = [name for wheel in wheels for name in wheel.namelist()]
    own = set(wheels[0].namelist())
    weights = ROOT / "src/omad/model/weights"
    shipped = {f"omad/model/weights/{path.relative_to(weights).as_posix()}" for path in weights.rglob("*.*")}
    assert sorted(shipped) == sorted(name for name in files if name.startswith("omad/model/weights/"))
    assert {name.split("/")[3] for name in own if name.startswith("omad/model/weights/")} == set(CATEGORIES)
    assert not [name for name in own if "/ancsh/" in name and "/weights/" in name]
    assert {"omad/output/page.html", "omad/applications/tracking/page.html", "omad/py.typed"} <= own


def steps() -> list[tuple[str, str]]:
    """Instructions of the container file and what follows them."""
    text = (ROOT / "packaging/container/Containerfile").read_text()
    lines = re.sub(r"\\\n", " ", text).splitlines()
    return [(word, rest) for word, _, rest in (line.partition(" ") for line in lines if line and line[0] != "#")]


def test_the_container_serves_as_nobody_and_tells_whether_it_is_well():
    """As far as it can be told without an engine that builds it; that its wheel is built is tested above."""
    told = dict(steps())
    assert told["FROM"].startswith("docker.io/library/python:3.")
    [copied] = [shlex.split(rest)[:-1] for word, rest in steps() if word == "COPY"]
    for source in copied:
        assert (ROOT / source).is_file() or fnmatch(f"dist/omad-{__version__}-py3-none-any.whl", source)
    assert told["USER"] not in ("root", "0")
    assert [word for word, _ in steps()].count("USER") == 1
    command = json.loads(told["ENTRYPOINT"]) + json.loads(told["CMD"])
    served = parse(command[1:])
    assert command[0] == "omad"
    assert isinstance(served, Serve)
    assert (served.host, str(served.port)) == ("0.0.0.0", told["EXPOSE"])
    checked = json.loads(told["HEALTHCHECK"].partition("CMD ")[2])
    compile(checked[2], "the health check", "exec")
    assert f":{served.port}/health" in checked[2]
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    assert "serve" in extras
    assert "[serve]" in " ".join(rest for word, rest in steps() if word == "RUN")


@pytest.mark.parametrize("name", APART)
def test_versions_agree(name):
    own, apart = (tomllib.loads((ROOT / at / "pyproject.toml").read_text()) for at in (".", APART[name]))
    assert own["project"]["version"] == apart["project"]["version"] == __version__
    assert own["project"]["optional-dependencies"][name] == [f"omad-{name}=={__version__}"]


@pytest.mark.parametrize("name", APART)
def test_wheels_of_weights_bear_the_licence(name):
    assert (ROOT / APART[name] / "LICENSE").read_text() == (ROOT / "LICENSE").read_text()


@pytest.mark.parametrize("name", ["test", "release"])
def test_workflows_are_well_formed(name):
    workflow = yaml.safe_load((ROOT / f".github/workflows/{name}.yml").read_text())
    jobs = workflow["jobs"]
    for job in jobs.values():
        assert "uses" in job or (job["runs-on"] and job["steps"])
        assert set(job.get("needs", [])) <= set(jobs)
    if name == "test":
        assert jobs["test"]["strategy"]["matrix"]["python"] == ["3.11", "3.12", "3.13"]
    else:
        assert jobs["publish"]["permissions"] == {"id-token": "write"}
