"""The documentation site builds without a warning: every link, reference and docstring in it is right."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.slow
def test_site_builds_without_warnings(tmp_path):
    pytest.importorskip("sphinx", reason="the site's generator is an extra: pip install 'omad[docs]'")
    command = [
        sys.executable,
        "-m",
        "sphinx",
        "-W",
        "--keep-going",
        "-q",
        "-b",
        "html",
        str(ROOT / "docs"),
        str(tmp_path),
    ]
    built = subprocess.run(command, capture_output=True, text=True)
    assert built.returncode == 0, built.stderr
    for page in (ROOT / "docs").glob("*.md"):
        assert (tmp_path / page.with_suffix(".html").name).is_file()
    reference = (tmp_path / "api.html").read_text()
    assert "omad.estimation.estimator.Estimator.__call__" in reference
    assert "omad.estimation.estimate.Estimate.covariance" in reference


def test_every_page_can_be_reached():
    """The front page's tables of contents name each page."""
    front = (ROOT / "docs" / "index.md").read_text().splitlines()
    for page in (ROOT / "docs").glob("*.md"):
        assert page.stem == "index" or page.stem in front, f"{page.name} is missing from docs/index.md"
