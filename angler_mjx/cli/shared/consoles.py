"""Consoles of the commands."""

import os
import sys

from rich.console import Console

KERNEL_VARIABLE = "JPY_PARENT_PID"
"""Environment variable of Jupyter's kernels, inherited by the commands that their cells start."""


def make_progress_console(*, quiet: bool = False) -> Console:
    """Return a console on stderr that redraws only where a person watches a terminal.

    Rich takes FORCE_COLOR for a terminal, and Jupyter sets it for its cells, which print codes of
    the cursor as they stand. There, as in a pipe or a file, displays print lines.

    Args:
        quiet: whether nothing is shown.
    """
    is_redrawn = sys.stderr.isatty() and KERNEL_VARIABLE not in os.environ
    return Console(stderr=True, quiet=quiet, force_terminal=None if is_redrawn else False)
