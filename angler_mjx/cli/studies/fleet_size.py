"""`angler study fleet_size`: the smallest team that meets a deadline."""

import json as text
import sys
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn

from angler_mjx.cli.shared.device import Device, choose, join, keep_all_programs
from angler_mjx.cli.shared.progress import Shown


def fleet_size(
    source: Annotated[Path, tyro.conf.Positional],
    out: Path | None = None,
    only: tuple[str, ...] = (),
    batch: int | None = None,
    most_worlds: int | None = None,
    most_minutes: float | None = None,
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
    """Find the smallest team that does a task by a deadline, with the interval of that answer.

    Worlds are added where the answer is open, until it is as sharp as the file asks or its budget
    is spent. docs/fleet_size.md says what a file holds and how to read what comes of it.

    Args:
        source: Name of a shipped study (survey_reef, delivery_corridor, reef_crossing), or a file
            (.toml).
        out: Folder to make; runs/NAME if left out, runs/NAME-smoke with --smoke.
        only: Names of the conditions to look at; all of the file if left out.
        batch: Worlds of one size and condition at a time; the file's if left out.
        most_worlds: Of one size and condition; the file's if left out.
        most_minutes: No batch begins later than this; the file's if left out.
        smoke: Fly four worlds of two sizes in each condition, to see that it runs: of the smallest
            and of the one in the middle of those that are flown first.
        resume: Go on with an interrupted study in the same folder; nothing is flown twice.
        device: Where to compute; JAX's choice if left out.
        devices: Number of devices to spread the worlds over; all there are if left out. Changes no
            byte of the results.
        distributed: Share every batch with other processes, here or on other hosts; each is started
            with the same arguments and sees the same folder.
        coordinator: Where process 0 can be reached, HOST:PORT; Slurm and Open MPI tell it.
        processes: How many processes there are; Slurm and Open MPI tell it.
        process: Index of this one, from 0; Slurm and Open MPI tell it.
        json: Print one JSON object instead of the tables.
    """
    choose(device, distributed=distributed)
    keep_all_programs()
    shared = join(
        device,
        distributed=distributed,
        coordinator=coordinator,
        processes=processes,
        process=process,
    )
    from angler_mjx.runs.processes import telling
    from angler_mjx.shipped import find_shipped
    from angler_mjx.studies.fleet_size import conditions, running

    with telling(shared):
        source = find_shipped(source, "angler_mjx.studies.fleet_size", "study")
        study = conditions.read(
            source,
            only,
            smoke=smoke,
            batch=batch,
            most_worlds=most_worlds,
            most_minutes=most_minutes,
        )
    place = out or Path("runs") / (f"{study.config.name}-smoke" if smoke else study.config.name)
    with _Bar(quiet=json or shared.index > 0) as bar:
        found = running.run(
            study, source, place, told=bar, resume=resume, devices=devices, processes=shared
        )
    shared.leave()
    if shared.index == 0:
        _report(found, place, as_json=json)
    if found["ended"] == running.STOPPED:
        print(f"interrupted: go on with --resume --out {place}", file=sys.stderr)
        sys.exit(130)


def _report(found: dict[str, Any], place: Path, *, as_json: bool) -> None:
    """End of a study: one JSON object, or the table and the place of the folder."""
    if as_json:
        print(text.dumps({**found, "study": str(place)}))
        return
    from rich.console import Console

    from angler_mjx.cli.shared.text_table import table as text_table
    from angler_mjx.studies.fleet_size import report

    head, rows = report.answers_table(found)
    shown = text_table(
        *head,
        title=f"{found['name']}: done within {found['deadline_s']:g} s with a probability of "
        f"{100 * found['probability']:g} %",
    )
    for row in rows:
        shown.add_row(*row)
    console = Console()
    console.print(shown)
    console.print(report.ENDED[found["ended"]], highlight=False)
    print(place / "page.md")


class _Bar(Shown):
    """What is flown, and the answer so far, on stderr; a `fleet_size.running.StudyProgress`."""

    def __init__(self, *, quiet: bool) -> None:
        super().__init__(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("worlds"),
            TimeElapsedColumn(),
            quiet=quiet,
        )
        self._task = self._bar.add_task("setting up", total=None)
        self._said: dict[str, str] = {}

    def tell(self, text: str) -> None:
        """See `angler_mjx.studies.fleet_size.running.StudyProgress`."""
        self._bar.console.print(text, highlight=False, markup=False)

    def begin(self, condition: str, size: int) -> None:
        """See `angler_mjx.studies.fleet_size.running.StudyProgress`."""
        self._bar.update(self._task, description=f"{condition}, {size} robots")

    def flown(self, condition: str, worlds: int, so_far: str) -> None:
        """See `angler_mjx.studies.fleet_size.running.StudyProgress`."""
        self._bar.advance(self._task, worlds)
        if self._said.get(condition) != so_far:
            self._said[condition] = so_far
            self._bar.console.print(f"{condition}: {so_far}", highlight=False, markup=False)
