"""`angler scenarios`: list shipped scenarios, print a file, print the keys of such files."""

import sys
from typing import Annotated, Literal

import tyro


def list_scenarios() -> None:
    """List the shipped scenarios."""
    from rich.console import Console

    from angler_mjx.cli.shared.text_table import build_text_table as text_table
    from angler_mjx.scenario.scenario import load_scenario, shipped_scenarios

    table = text_table("scenario", "robots", "description")
    for name in shipped_scenarios():
        scenario = load_scenario(name)
        table.add_row(name, str(len(scenario.members())), scenario.description)
    Console().print(table)


def show_scenario(scenario: Annotated[str, tyro.conf.Positional]) -> None:
    """Print the file of a scenario, to read or as the start of a new scenario.

    Args:
        scenario: Name of a shipped scenario, or path of a scenario file (.toml).
    """
    from angler_mjx.errors import escape_control_characters
    from angler_mjx.files import MAX_TOML_BYTES, read_text
    from angler_mjx.scenario.scenario import find_scenario

    text = read_text(find_scenario(scenario), MAX_TOML_BYTES)
    sys.stdout.write(escape_control_characters(text, keep="\n\t") if sys.stdout.isatty() else text)


def print_reference(file: Annotated[Literal["scenario", "vehicle"], tyro.conf.Positional]) -> None:
    """Print the keys of a file: types, units, defaults, bounds, meanings.

    Args:
        file: Kind of file.
    """
    from angler_mjx.scenario.reference import format_page

    sys.stdout.write(format_page(file))
