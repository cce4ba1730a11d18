"""Run notebooks by a Jupyter kernel of this Python, each in a folder of its own."""

import os
import re
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import nbformat
from nbclient import NotebookClient

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "docs" / "notebooks"
LIMIT_S = 300
"""Wall-clock limit of a cell, s."""
PROGRESS = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]|[^\n]*\r(?!\n)")
"""Colours, and lines that were written over."""


def list_notebooks() -> list[Path]:
    """Return the notebooks of the documentation, by name."""
    return sorted(FOLDER.glob("*.ipynb"))


def run_notebook(path: Path) -> nbformat.NotebookNode:
    """Return a notebook with the outputs of a new run; files that it writes are deleted.

    Raises:
        nbclient.exceptions.CellExecutionError: a cell raised.
    """
    notebook = nbformat.read(path, as_version=4)
    with tempfile.TemporaryDirectory() as folder, _commands_on_path():
        NotebookClient(
            notebook,
            timeout=LIMIT_S,
            startup_timeout=LIMIT_S,
            resources={"metadata": {"path": folder}},
        ).execute()
        for cell in notebook.cells:
            for output in cell.get("outputs", ()):
                _clean_output(output, folder)
            cell.metadata.pop("execution", None)
    return notebook


@contextmanager
def _commands_on_path() -> Iterator[None]:
    """Let cells find the commands that are installed beside this Python."""
    before = os.environ.get("PATH", "")
    os.environ["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{before}"
    try:
        yield
    finally:
        os.environ["PATH"] = before


def _clean_output(output: nbformat.NotebookNode, folder: str) -> None:
    """Take colours, overwritten lines and the folder of the run out of a text."""
    if "text" in output:
        output.text = PROGRESS.sub("", output.text).replace(f"{folder}/", "")
