"""`angler export`: a run in a format that other programs open."""

from pathlib import Path
from typing import Annotated

import tyro

from angler_mjx.errors import ConfigError

MAX_DIGITS = 10
"""Max number of digits of a world index: a run has 1e9 worlds at most."""


def export(
    run: Annotated[Path, tyro.conf.Positional],
    mcap: Path,
    worlds: str | None = None,
    force: bool = False,
) -> None:
    """Write worlds of a run folder into a bag for ROS 2 and Foxglove.

    Args:
        run: Run folder.
        mcap: Bag to make, for example out.mcap.
        worlds: Indices of the worlds, as in 0,3; the worst and one good world if left out.
        force: Replace an older bag.
    """
    world_indices = None if worlds is None else parse_indices(worlds)
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn

    from angler_mjx.cli.shared.consoles import make_progress_console
    from angler_mjx.report.interop import mcap as bags
    from angler_mjx.report.viewing.world_selection import good_world, worst_world
    from angler_mjx.runs.storage.folder import Run

    loaded = Run(run)
    columns = ("samples", BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=make_progress_console()) as bar:
        task = bar.add_task("samples", total=None)
        bags.export_bag(
            loaded,
            mcap,
            [worst_world(loaded), good_world(loaded)] if world_indices is None else world_indices,
            force=force,
            progress=lambda done, total: bar.update(task, completed=done, total=total),
        )
    print(mcap)


def parse_indices(text: str) -> list[int]:
    """Parse whole numbers separated by commas.

    Raises:
        ConfigError: the text has another form, or an index exceeds any run.
    """
    from angler_mjx.errors import format_value

    parts = [part.strip() for part in text.split(",")]
    if not all(part.isdecimal() for part in parts):
        raise ConfigError(
            f"--worlds {format_value(text)}: give indices with commas between them, as in 0,3"
        )
    if too_long := [part for part in parts if len(part) > MAX_DIGITS]:
        raise ConfigError(f"--worlds {format_value(too_long[0])}: no run holds so many worlds")
    return [int(part) for part in parts]
