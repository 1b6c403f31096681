"""What is shipped: a small wheel without the baselines, which come apart, and workflows that build and publish both."""

import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest
import yaml

from omad import __version__

ROOT = Path(__file__).parents[2]


def built(project: Path, folder: Path) -> zipfile.ZipFile:
    pytest.importorskip("build", reason="pip install build hatchling: no wheel can be built without")
    pytest.importorskip("hatchling", reason="pip install build hatchling: no wheel can be built without")
    command = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(folder), str(project)]
    subprocess.run(command, check=True, capture_output=True)
    [wheel] = folder.glob("*.whl")
    assert wheel.stat().st_size < 20e6
    return zipfile.ZipFile(wheel)


@pytest.mark.slow
def test_the_wheel_is_small_and_the_baselines_come_apart(tmp_path):
    own = set(built(ROOT, tmp_path / "own").namelist())
    apart = set(built(ROOT / "packaging" / "baselines", tmp_path / "apart").namelist())
    weights = ROOT / "src/omad/model/weights"
    shipped = {f"omad/model/weights/{path.relative_to(weights).as_posix()}" for path in weights.rglob("*.*")}
    assert shipped == {name for name in own | apart if name.startswith("omad/model/weights/")}
    assert not own & apart
    assert not [name for name in own if "/ancsh/" in name and "/weights/" in name]
    assert {"omad/output/page.html", "omad/applications/tracking/page.html", "omad/py.typed"} <= own


def test_versions_agree():
    own, apart = (tomllib.loads((ROOT / name / "pyproject.toml").read_text()) for name in (".", "packaging/baselines"))
    assert own["project"]["version"] == apart["project"]["version"] == __version__
    assert own["project"]["optional-dependencies"]["baselines"] == [f"omad-baselines=={__version__}"]


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
