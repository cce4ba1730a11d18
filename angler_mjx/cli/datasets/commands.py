"""`angler dataset`: make, show and judge datasets."""

import json as text
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from angler_mjx.cli.shared.device import Device, choose, join, keep_all_programs
from angler_mjx.errors import ConfigError, RunError

if TYPE_CHECKING:
    from angler_mjx.learning.datasets.manifest import Manifest


SHOWN = 100
"""Findings that are printed."""


def make(
    config: Annotated[Path, tyro.conf.Positional],
    episodes: int,
    out: Path | None = None,
    resume: bool = False,
    device: Device | None = None,
    devices: int | None = None,
    workers: int | None = None,
    distributed: bool = False,
    coordinator: str | None = None,
    processes: int | None = None,
    process: int | None = None,
) -> None:
    """Fly the episodes of a dataset file, and write them with all that is to be known of them.

    Args:
        config: Name of a shipped dataset file (reef), or the path of one (.toml).
        episodes: How many, of all scenes, teams and experts together.
        out: Folder to make; datasets/NAME if left out.
        resume: Go on with an interrupted one of the same file and number.
        device: Where to compute; JAX's choice if left out.
        devices: Number of devices to spread the worlds over; all there are if left out. Changes no
            byte of the results.
        workers: Processes that plan, where a planner is one of the host; one for each processor if
            left out. Changes no byte of the results.
        distributed: Share the flights with other processes, here or on other hosts; each is started
            with the same arguments and sees the same folders. Changes no byte of the results.
        coordinator: Where process 0 can be reached, HOST:PORT; Slurm and Open MPI tell it.
        processes: How many processes there are; Slurm and Open MPI tell it.
        process: Index of this one, from 0; Slurm and Open MPI tell it.
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
    from angler_mjx.cli.shared.inputs import at_least_one
    from angler_mjx.cli.shared.progress import PartsBar
    from angler_mjx.learning.datasets import making, manifest
    from angler_mjx.runs.processes import telling
    from angler_mjx.shipped import find_shipped

    with telling(shared):
        config = find_shipped(config, "angler_mjx.learning.datasets", "dataset file")
        asked = making.read_request(config, episodes)
    place = out or Path("datasets") / asked.config.name
    with PartsBar(quiet=shared.index > 0) as bar:
        made = making.make(
            asked,
            place,
            told=bar,
            resume=resume,
            devices=devices,
            workers=at_least_one("workers", workers),
            processes=shared,
        )
    shared.leave()
    if made is None:
        print(f"interrupted; go on with --resume --out {place}", file=sys.stderr)
        sys.exit(130)
    if shared.index == 0 and (fault := _report(made, manifest.read(made))):
        raise RunError(f"the planner of every part {fault}; {made} holds flights without plans")


def show(dataset: Annotated[Path, tyro.conf.Positional]) -> None:
    """Say what is in a dataset.

    Args:
        dataset: Its folder.
    """
    from angler_mjx.learning.datasets import manifest

    _report(dataset, manifest.read(dataset))


def _report(place: Path, found: "Manifest") -> str | None:
    """Print what is in a dataset; return why no robot has a plan, where planners raised."""
    from rich.console import Console

    from angler_mjx.cli.shared.text_table import table as text_table
    from angler_mjx.runs.storage import planned
    from angler_mjx.runs.storage.folder import Run

    title = f"{found.name}: {found.episodes:,} episodes"
    head = ("part", "expert", "robots", "worlds", "with a plan", "split")
    shown = text_table(*head, fixed=0, title=title)
    for column in shown.columns[2:5]:
        column.justify = "right"
    reasons: list[str] = []
    faults: list[str | None] = []
    for part in found.parts:
        split = part.split or "by environment"
        planning = planned.summarise(Run(place / part.path).episodes)
        share = planned.percent(planning)
        shown.add_row(part.path, part.expert, str(part.robots), f"{part.worlds:,}", share, split)
        reasons += [f"{part.path}: {line}" for line in planned.lines(planning)]
        faults.append(planned.fault(planning))
    console = Console()
    console.print(shown)
    for line in reasons:
        console.print(line, highlight=False, markup=False, soft_wrap=True)
    console.print(", ".join(f"{name}: {count:,}" for name, count in found.splits.items()))
    if found.sample.asks:
        said = (
            f"{name}: {found.chosen.get(name, 0):,} of {count:,}"
            for name, count in found.splits.items()
        )
        console.print(f"chosen of {', '.join(said)}")
    console.print(str(place), highlight=False, soft_wrap=True)
    return faults[0] if all(faults) else None


def verify(
    dataset: Annotated[Path, tyro.conf.Positional],
    again: int = 0,
    device: Device | None = None,
    json: Annotated[bool, tyro.conf.arg(name="json")] = False,
) -> None:
    """Judge a dataset: its files, its values, and some of its episodes by flying them again.

    With the tile, kind of device and versions that made it every byte must come out the same;
    elsewhere flights may part, and the report says how far they do. Exits with 0 when nothing is
    wrong, with 1 when something is, with 2 when there is no dataset that could be judged.

    Args:
        dataset: Its folder.
        again: How many episodes to fly again, spread over its parts.
        device: Where to compute; JAX's choice if left out.
        json: Print one JSON object instead of the table.
    """
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

    if again < 0:
        raise ConfigError(f"--again {again}: must be 0 or more")
    choose(device, distributed=False)
    keep_all_programs()
    from angler_mjx.learning.datasets.verifying import judging

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    with Progress(*columns, console=Console(stderr=True, quiet=json)) as bar:
        task = bar.add_task("files", total=None)
        report = judging.verify(
            dataset,
            again,
            lambda what, done, of: bar.update(task, description=what, completed=done, total=of),
        )
    if json:
        print(text.dumps(report.table()))
    else:
        for one in report.findings[:SHOWN]:
            print(one.line())
        if (more := len(report.findings) - SHOWN) > 0:
            print(f"... and {more} more; --json holds all of them")
        for check in report.checks:
            print(check.line())
    if not report.agrees:
        sys.exit(1)


def repair(
    dataset: Annotated[Path, tyro.conf.Positional],
    accept: bool = False,
    device: Device | None = None,
) -> None:
    """Fly again what of a dataset was damaged or lost; what is whole is kept.

    Args:
        dataset: Its folder.
        accept: Keep flights that come out otherwise than before, on another device or version.
        device: Where to compute; JAX's choice if left out.
    """
    choose(device, distributed=False)
    keep_all_programs()
    from angler_mjx.cli.shared.progress import PartsBar
    from angler_mjx.learning.datasets.keeping import repair as keeping

    with PartsBar() as bar:
        done = keeping.repair(dataset, bar, accept=accept)
    if not done.damaged:
        print("nothing is damaged")
        return
    print(f"{len(done.damaged)} files were damaged or lost, {done.damaged[0]} first")
    print(f"flown again: {', '.join(done.parts) or 'nothing'}")
    if done.other:
        print(f"{len(done.other)} files have other bytes than before, {done.other[0]} first")


def merge(datasets: Annotated[tuple[Path, ...], tyro.conf.Positional], out: Path) -> None:
    """Make one dataset of several that were recorded in one way.

    Args:
        datasets: Their folders.
        out: Folder to make; files are linked into it where the disk can.
    """
    from angler_mjx.learning.datasets import manifest
    from angler_mjx.learning.datasets.keeping import merge as keeping

    made = keeping.merge(datasets, out)
    _report(made, manifest.read(made))


def stats(
    dataset: Annotated[Path, tyro.conf.Positional],
    json: Annotated[bool, tyro.conf.arg(name="json")] = False,
) -> None:
    """Count what is in a dataset: splits, experts, outcomes, and means and deviations of fields.

    Args:
        dataset: Its folder.
        json: Print one JSON object instead of tables.
    """
    from rich.console import Console

    from angler_mjx.cli.shared.text_table import table as text_table
    from angler_mjx.errors import size
    from angler_mjx.learning.datasets.keeping import counting

    found = counting.stats(dataset)
    if json:
        print(text.dumps(found))
        return
    console = Console()
    console.print(
        f"{found['name']}: {found['episodes']:,} episodes, {found['chosen']:,} of them chosen, "
        f"{found['robots']:,} robots, "
        f"{size(found['bytes'])}"
    )
    for column, values in found["by"].items():
        table = text_table(column, "episodes", "robots with a plan", "whole teams that arrive")
        for name, value in values.items():
            shares = (f"{100 * value[key]:.1f} %" for key in ("planned", "success"))
            table.add_row(name, f"{value['episodes']:,}", *shares)
        console.print(table)
    table = text_table("robots that ended by", "number", "share")
    total = sum(found["outcomes"].values())
    for name, count in sorted(found["outcomes"].items(), key=lambda one: -one[1]):
        table.add_row(name, f"{count:,}", f"{100 * count / total:.1f} %")
    console.print(table)
    table = text_table("of episodes", "10 %", "median", "90 %")
    for name, value in found["quantiles"].items():
        table.add_row(name, *(f"{value[key]:.3g}" for key in ("p10", "p50", "p90")))
    console.print(table)
    table = text_table("field", "mean", "standard deviation")
    rows = list(found["fields"].items())
    for vehicle, fields in found["fields_by_vehicle"].items():
        rows += [(f"{name} of {vehicle}", value) for name, value in fields.items()]
    for name, value in rows:
        table.add_row(name, *(_numbers(value[key]) for key in ("mean", "std")))
    console.print(table)


def _numbers(values: list[float | None]) -> str:
    return " ".join("-" if value is None else f"{value:.3g}" for value in values)


def export(
    dataset: Annotated[Path, tyro.conf.Positional],
    to: Literal["lerobot", "minari", "mpinets", "parquet"],
    out: Path,
    action: Literal["target", "pwm"] = "target",
    split: str | None = None,
    success: bool | None = None,
) -> None:
    """Write a dataset in the format of another library, a robot's flight an episode.

    Args:
        dataset: Its folder, or a run folder.
        to: LeRobot 3.0, Minari, the HDF5 of motion policy networks, or plain Parquet.
        out: Folder to make.
        action: What robots did: where their controllers aimed, or pulse widths.
        split: Only this split.
        success: Only episodes in which the whole team arrived (--success), or only the others.
    """
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn

    from angler_mjx.learning.datasets.exports import writing

    columns = ("flights", BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task("flights", total=None)
        made = writing.export(
            dataset,
            out,
            to=to,
            action=action,
            split=split,
            success=success,
            tell=lambda done, of: bar.update(task, completed=done, total=of),
        )
    print(made)
