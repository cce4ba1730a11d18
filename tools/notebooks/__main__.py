"""``python -m tools.notebooks``: run notebooks and store them with their outputs."""

import os
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import nbformat
import tyro

from tools.notebooks.running import list_notebooks, reason_to_skip, run_notebook, set_badge


@dataclass(frozen=True, kw_only=True)
class NotebookOptions:
    """Run notebooks of docs/notebooks, each in a new folder, and store their outputs.

    Needs the extra `docs`.
    """

    names: Annotated[tuple[str, ...], tyro.conf.Positional] = ()
    """Names of notebooks; all if left out."""
    check: bool = False
    """Store nothing: only see whether they run."""
    badges: bool = False
    """Run nothing: only write the badges that open them in Colab."""


def main(options: NotebookOptions) -> int:
    """Run the notebooks; return the exit code."""
    notebooks = {path.stem: path for path in list_notebooks()}
    if unknown := set(options.names) - set(notebooks):
        print(f"notebooks: no such notebook: {', '.join(sorted(unknown))}", file=sys.stderr)
        return 2
    for name in options.names or notebooks:
        if options.badges:
            _store_notebook(nbformat.read(notebooks[name], as_version=4), notebooks[name])
            continue
        if reason := reason_to_skip(notebooks[name]):
            print(f"{name}: skipped: {reason}", flush=True)
            continue
        start_s, processor_s = time.monotonic(), _processor_s()
        notebook = run_notebook(notebooks[name])
        if not options.check:
            _store_notebook(notebook, notebooks[name])
        elapsed_s, processor_s = time.monotonic() - start_s, _processor_s() - processor_s
        print(f"{name}: {elapsed_s:.0f} s, {processor_s:.0f} s of processor time", flush=True)
    return 0


def _store_notebook(notebook: nbformat.NotebookNode, path: Path) -> None:
    set_badge(notebook, path.stem)
    nbformat.write(notebook, path)


def _processor_s() -> float:
    """Return the processor time [s] of ended child processes: kernels and their commands."""
    times = os.times()
    return times.children_user + times.children_system


if __name__ == "__main__":
    sys.exit(main(tyro.cli(NotebookOptions)))
