"""`angler study fleet_size`: the smallest team that meets a deadline."""

import json as text
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from angler_mjx.cli.shared.device import Device, choose_device, join_processes, keep_all_programs
from angler_mjx.cli.shared.progress import ProgressBar

if TYPE_CHECKING:
    from angler_mjx.studies.fleet_size.report import FleetSizeResults


def fleet_size(
    source: Annotated[Path, tyro.conf.Positional],
    out: Path | None = None,
    only: tuple[str, ...] = (),
    batch: int | None = None,
    max_worlds: int | None = None,
    max_minutes: float | None = None,
    smoke: bool = False,
    resume: bool = False,
    device: Device | None = None,
    devices: int | None = None,
    distributed: bool = False,
    coordinator: str | None = None,
    processes: int | None = None,
    process: int | None = None,
    json: Annotated[bool, tyro.conf.arg(name="json")] = False,
) -> None:
    """Find the smallest team that does a task by a deadline, with a confidence interval.

    Worlds are added where the answer is open, until its precision is that requested in the file or
    its budget is spent. docs/how_to/fleet_size.md explains the file and the results.

    Args:
        source: Name of a shipped study (survey_reef, delivery_corridor, reef_crossing, carry_pipe),
            or a file (.toml).
        out: Folder to make; runs/NAME if left out, runs/NAME-smoke with --smoke.
        only: Names of the conditions to study; all of the file if left out.
        batch: Number of worlds of one size and condition at a time; the file's if left out.
        max_worlds: Max number of worlds of one size and condition; the file's if left out.
        max_minutes: Time in minutes after which no batch begins; the file's if left out.
        smoke: Fly four worlds of two sizes in each condition, as a test: the smallest size and the
            middle one of those that are flown first.
        resume: Continue an interrupted study in the same folder; nothing is flown twice.
        device: Device to compute on; JAX's choice if left out.
        devices: Number of devices to spread the worlds over; all available if left out. Changes no
            byte of the results.
        distributed: Share every batch with other processes, here or on other hosts; each is started
            with the same arguments and sees the same folder.
        coordinator: Address of process 0, HOST:PORT; detected under Slurm and Open MPI.
        processes: Number of processes; detected under Slurm and Open MPI.
        process: Index of this process, from 0; detected under Slurm and Open MPI.
        json: Print one JSON object instead of the tables.
    """
    choose_device(device, distributed=distributed)
    keep_all_programs()
    process_group = join_processes(
        device,
        distributed=distributed,
        coordinator=coordinator,
        processes=processes,
        process=process,
    )
    from angler_mjx.runs.processes import reporting_failure
    from angler_mjx.shipped import find_shipped
    from angler_mjx.studies.fleet_size import conditions, running

    with reporting_failure(process_group):
        source = find_shipped(source, "angler_mjx.studies.fleet_size", "study")
        study = conditions.read_study(
            source,
            only,
            smoke=smoke,
            batch=batch,
            max_worlds=max_worlds,
            max_minutes=max_minutes,
        )
    out_path = out or Path("runs") / (f"{study.config.name}-smoke" if smoke else study.config.name)
    with ProgressBar(quiet=json or process_group.index > 0) as bar:
        results = running.run_study(
            study,
            source,
            out_path,
            progress=bar,
            resume=resume,
            devices=devices,
            processes=process_group,
        )
    process_group.leave()
    if process_group.index == 0:
        _print_study(results, out_path, as_json=json)
    if results["ended"] == running.STOPPED:
        print(f"interrupted: go on with --resume --out {out_path}", file=sys.stderr)
        sys.exit(130)


def _print_study(results: "FleetSizeResults", path: Path, *, as_json: bool) -> None:
    """Print the end of a study: one JSON object, or the table and the path of the folder."""
    if as_json:
        print(text.dumps({**results, "study": str(path)}))
        return
    from rich.console import Console

    from angler_mjx.cli.shared.text_table import build_text_table as text_table
    from angler_mjx.studies.fleet_size import report

    header, rows = report.answers_table(results)
    table = text_table(
        *header,
        title=f"{results['name']}: done within {results['deadline_s']:g} s with a probability of "
        f"{100 * results['probability']:g} %",
    )
    for row in rows:
        table.add_row(*row)
    console = Console()
    console.print(table)
    console.print(report.ENDING_TEXTS[results["ended"]], highlight=False)
    print(path / "page.md")
