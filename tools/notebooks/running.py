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

from angler_mjx.errors import AnglerError
from angler_sitl.firmware.binary import find_binary

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "docs" / "notebooks"
REPOSITORY = "OWNER/REPOSITORY"
"""Repository on GitHub from which Colab opens notebooks: TO BE FILLED IN BY THE OWNER; then
``python -m tools.notebooks --badges``."""
LIMIT_S = 900
"""Wall-clock limit of a cell, s."""
NEEDS = "needs"
"""Key of a notebook's metadata ``angler``: program that it cannot run without."""
PROGRESS = re.compile(
    r"\x1b\[[0-9;?]*[A-Za-z]|[^\n]*\r(?!\n)"
    r"|^[^\n]*━[^\n]*\d:\d\d:\d\d[^\n]*\n(?: +vehicle-steps/s *\n)?"
    r"|^[IWE]\d{4} \d\d:\d\d:\d\d\.[^\n]*\n",
    re.M,
)
"""Colours, lines that were written over, bars of progress, messages of XLA to its developers."""


def list_notebooks() -> list[Path]:
    """Return the notebooks of the documentation, by name."""
    return sorted(FOLDER.glob("*.ipynb"))


def reason_to_skip(path: Path) -> str | None:
    """Return why a notebook cannot run on this machine, or None."""
    metadata = nbformat.read(path, as_version=4).metadata
    if metadata.get("angler", {}).get(NEEDS) != "ardusub":
        return None
    try:
        find_binary()
    except AnglerError as error:
        return str(error)
    return None


def format_badge(name: str) -> str:
    """Return the line of Markdown that opens a notebook in Colab."""
    colab = "https://colab.research.google.com"
    address = f"{colab}/github/{REPOSITORY}/blob/main/docs/notebooks/{name}.ipynb"
    return f"[![Open in Colab]({colab}/assets/colab-badge.svg)]({address})"


def set_badge(notebook: nbformat.NotebookNode, name: str) -> None:
    """Put the badge below the title of a notebook, in place of an older one."""
    title, *lines = notebook.cells[0].source.split("\n")
    text = "\n".join(line for line in lines if not line.startswith("[![Open in Colab]"))
    notebook.cells[0].source = f"{title}\n\n{format_badge(name)}\n\n{text.strip()}"


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
            coalesce_streams=True,  # a progress line is one output, not a thousand
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
        text = PROGRESS.sub("", output.text.replace("\r\n", "\n")).replace(f"{folder}/", "")
        output.text = text.replace(f"{Path(folder).name}/", "")  # messages name the last two parts
