"""`angler scenarios`: list shipped scenarios, print a file, print the keys of files."""

import sys
from pathlib import Path
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


def print_reference(
    file: Annotated[Literal["scenario", "vehicle", "study", "dataset"], tyro.conf.Positional],
) -> None:
    """Print the keys of a file: types, units, defaults, bounds, meanings.

    Args:
        file: Kind of file.
    """
    from angler_mjx.cli.reference import format_page

    sys.stdout.write(format_page(file))


def import_problem(
    file: Annotated[Path, tyro.conf.Positional],
    map_: Annotated[Path | None, tyro.conf.arg(name="map")] = None,
    robots: int | None = None,
    region: tuple[int, ...] = (),
    scale_m: float = 1.5,
    layers: int = 3,
    vehicle: str = "bluerov2_heavy",
    out: Path | None = None,
) -> None:
    """Import a planning problem of another benchmark as a scenario; list what differs from it.

    Args:
        file: MovingAI's .scen or .3dscen, or a problem of db-CBS or dynobench (.yaml).
        map_: Map of MovingAI's files (.map or .3dmap); the one that they name, beside them, if left
            out.
        robots: Number of robots: the first rows of MovingAI's files, the first robots of others;
            all of the latter if left out.
        region: Part of a map, first cell and last cell along each axis: x0 y0 x1 y1, or x0 y0 z0 x1
            y1 z1; all if left out.
        scale_m: Metres of a unit of the file: a cell's edge, or a length of 1.
        layers: Cells along z of problems in the plane.
        vehicle: Name of a shipped vehicle, or path of a vehicle file.
        out: Scenario file to write; must not exist. NAME.toml here if left out.
    """
    from angler_mjx.cli.shared.inputs import require_positive
    from angler_mjx.report.interop.problem_files import import_problem as importing
    from angler_mjx.runs.storage.atomic_files import replace_file

    imported = importing.import_problem(
        file,
        map_file=map_,
        robots=require_positive("robots", robots),
        region=region or None,
        scale_m=scale_m,
        layers=layers,
        vehicle=vehicle,
    )
    target = Path(f"{imported.scenario.name}.toml") if out is None else out
    with replace_file(target, flag="--out") as writing:
        writing.write_text(imported.text, encoding="utf-8")
    for note in imported.notes:
        print(note)
    print(target)
