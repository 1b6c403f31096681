"""Executes the notebooks of docs/notebooks, each in an empty folder, and keeps their outputs in them:
``python docs/run_notebooks.py [NAME ...]``"""

import sys
import tempfile
from pathlib import Path

import nbformat
from nbclient import NotebookClient

FOLDER = Path(__file__).with_name("notebooks")
SECONDS = 900


def executed(file: Path, folder: Path) -> nbformat.NotebookNode:
    """A notebook with its outputs, run in ``folder``. Raises CellExecutionError where a cell fails."""
    notebook = nbformat.read(file, as_version=4)
    NotebookClient(notebook, timeout=SECONDS, resources={"metadata": {"path": str(folder)}}).execute()
    for cell in notebook.cells:
        cell.metadata.pop("execution", None)  # times, which differ from run to run
        for output in cell.get("outputs", []):
            if output.output_type == "stream" and output.name == "stderr":
                output.text = ""
        if cell.cell_type == "code":
            cell.outputs = [output for output in cell.outputs if output.get("text", "-") != ""]
    notebook.metadata.pop("language_info", None)
    return notebook


if __name__ == "__main__":
    for file in sorted(FOLDER.glob("*.ipynb")):
        if not sys.argv[1:] or file.stem in sys.argv[1:]:
            with tempfile.TemporaryDirectory() as scratch:
                nbformat.write(executed(file, Path(scratch)), file)
