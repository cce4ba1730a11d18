"""`angler scenarios`: what ships, what is in it, and what may stand in such a file."""

import sys
from typing import Annotated, Literal

import tyro


def list_() -> None:
    """List the shipped scenarios."""
    from rich.console import Console

    from angler_mjx.cli.shared.text_table import table as text_table
    from angler_mjx.scenario.scenario import load_scenario, shipped

    table = text_table("scenario", "robots", "description")
    for name in shipped():
        scenario = load_scenario(name)
        table.add_row(name, str(len(scenario.members())), scenario.description)
    Console().print(table)


def show(scenario: Annotated[str, tyro.conf.Positional]) -> None:
    """Print the file of a scenario: to read it, or to begin one of your own.

    Args:
        scenario: Name of a shipped scenario, or path of a scenario file (.toml).
    """
    from angler_mjx.errors import escaped
    from angler_mjx.files import TOML_BYTES, read_text
    from angler_mjx.scenario.scenario import find

    text = read_text(find(scenario), TOML_BYTES)
    sys.stdout.write(escaped(text, keep="\n\t") if sys.stdout.isatty() else text)


def reference(file: Annotated[Literal["scenario", "vehicle"], tyro.conf.Positional]) -> None:
    """Print what may stand in a file, key by key: types, units, defaults, bounds, meanings.

    Args:
        file: The kind of file.
    """
    from angler_mjx.scenario.reference import page

    sys.stdout.write(page(file))
