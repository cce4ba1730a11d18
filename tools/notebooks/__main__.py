"""``python -m tools.notebooks``: run notebooks and store them with their outputs."""

import sys
import time
from dataclasses import dataclass
from typing import Annotated

import nbformat
import tyro

from tools.notebooks.running import list_notebooks, run_notebook


@dataclass(frozen=True, kw_only=True)
class NotebookOptions:
    """Run notebooks of docs/notebooks, each in a new folder, and store their outputs.

    Needs the extra `docs`.
    """

    names: Annotated[tuple[str, ...], tyro.conf.Positional] = ()
    """Names of notebooks; all if left out."""
    check: bool = False
    """Store nothing: only see whether they run."""


def main(options: NotebookOptions) -> int:
    """Run the notebooks; return the exit code."""
    notebooks = {path.stem: path for path in list_notebooks()}
    if unknown := set(options.names) - set(notebooks):
        print(f"notebooks: no such notebook: {', '.join(sorted(unknown))}", file=sys.stderr)
        return 2
    for name in options.names or notebooks:
        start = time.monotonic()
        notebook = run_notebook(notebooks[name])
        if not options.check:
            nbformat.write(notebook, notebooks[name])
        print(f"{name}: {time.monotonic() - start:.0f} s", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(tyro.cli(NotebookOptions)))
