"""`angler dataset`: make, show and verify datasets."""

import json as text
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from angler_mjx.cli.shared.device import Device, choose_device, join_processes, keep_all_programs
from angler_mjx.errors import ConfigError, RunError

if TYPE_CHECKING:
    from angler_mjx.learning.datasets.manifest import Manifest


MAX_FINDINGS = 100
"""Max number of findings printed."""


def make_dataset(
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
    """Fly the episodes of a dataset file, and write them with their metadata.

    Args:
        config: Name of a shipped dataset file (reef, angler_reef_100k), or the path of one (.toml).
        episodes: Number of episodes, over all scenes, teams and experts.
        out: Folder to make; datasets/NAME if left out.
        resume: Continue an interrupted dataset of the same file and number.
        device: Device to compute on; JAX's choice if left out.
        devices: Number of devices to spread the worlds over; all available if left out. Changes no
            byte of the results.
        workers: Number of planning processes, for planners on the host; one for each processor if
            left out. Changes no byte of the results.
        distributed: Share the flights with other processes, here or on other hosts; each is started
            with the same arguments and sees the same folders. Changes no byte of the results.
        coordinator: Address of process 0, HOST:PORT; detected under Slurm and Open MPI.
        processes: Number of processes; detected under Slurm and Open MPI.
        process: Index of this process, from 0; detected under Slurm and Open MPI.
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
    from angler_mjx.cli.shared.inputs import require_positive
    from angler_mjx.cli.shared.progress import ProgressBar
    from angler_mjx.learning.datasets import generation, manifest
    from angler_mjx.runs.processes import reporting_failure
    from angler_mjx.shipped import find_shipped

    with reporting_failure(process_group):
        config = find_shipped(config, "angler_mjx.learning.datasets", "dataset file")
        request = generation.read_request(config, episodes)
    out_path = out or Path("datasets") / request.config.name
    with ProgressBar(quiet=process_group.index > 0) as bar:
        dataset_path = generation.make_dataset(
            request,
            out_path,
            progress=bar,
            resume=resume,
            devices=devices,
            workers=require_positive("workers", workers),
            processes=process_group,
        )
    process_group.leave()
    if dataset_path is None:
        print(f"interrupted; go on with --resume --out {out_path}", file=sys.stderr)
        sys.exit(130)
    if process_group.index == 0 and (
        fault := _print_dataset(dataset_path, manifest.read_manifest(dataset_path))
    ):
        raise RunError(
            f"the planner of every part {fault}; {dataset_path} holds flights without plans"
        )


def show_dataset(dataset: Annotated[Path, tyro.conf.Positional]) -> None:
    """Print a summary of a dataset.

    Args:
        dataset: Dataset folder.
    """
    from angler_mjx.learning.datasets import manifest

    _print_dataset(dataset, manifest.read_manifest(dataset))


def _print_dataset(path: Path, dataset_manifest: "Manifest") -> str | None:
    """Print a summary of a dataset; return why no robot has a plan, where planners raised."""
    from rich.console import Console

    from angler_mjx.cli.shared.text_table import build_text_table as text_table
    from angler_mjx.runs.storage import planning_summary
    from angler_mjx.runs.storage.folder import Run

    title = f"{dataset_manifest.name}: {dataset_manifest.episodes:,} episodes"
    header = ("part", "expert", "robots", "worlds", "with a plan", "split")
    table = text_table(*header, fixed=0, title=title)
    for column in table.columns[2:5]:
        column.justify = "right"
    reasons: list[str] = []
    faults: list[str | None] = []
    for part in dataset_manifest.parts:
        split = part.split or "by environment"
        planning = planning_summary.summarise_planning(Run(path / part.path).episodes)
        percent = planning_summary.format_percent(planning)
        table.add_row(part.path, part.expert, str(part.robots), f"{part.worlds:,}", percent, split)
        reasons += [f"{part.path}: {line}" for line in planning_summary.reason_lines(planning)]
        faults.append(planning_summary.planner_fault(planning))
    console = Console()
    console.print(table)
    for line in reasons:
        console.print(line, highlight=False, markup=False, soft_wrap=True)
    console.print(
        ", ".join(f"{name}: {count:,}" for name, count in dataset_manifest.splits.items())
    )
    if dataset_manifest.sample.has_bounds:
        split_texts = (
            f"{name}: {dataset_manifest.chosen.get(name, 0):,} of {count:,}"
            for name, count in dataset_manifest.splits.items()
        )
        console.print(f"chosen of {', '.join(split_texts)}")
    console.print(str(path), highlight=False, soft_wrap=True)
    return faults[0] if all(faults) else None


def verify_dataset(
    dataset: Annotated[Path, tyro.conf.Positional],
    again: int = 0,
    workers: int | None = None,
    device: Device | None = None,
    json: Annotated[bool, tyro.conf.arg(name="json")] = False,
) -> None:
    """Verify a dataset: its files, its values, and some of its episodes by flying them again.

    With the tile, kind of device and versions that made it every byte must be equal; elsewhere
    flights may differ, and the report says by how much. Exits with 0 when no fault is found, with 1
    when there are faults, with 2 when there is no dataset to verify.

    Args:
        dataset: Dataset folder.
        again: Number of episodes to fly again, spread over its parts.
        workers: Number of reading processes; if left out, one for each processor where there are
            enough episodes. Changes nothing in the report.
        device: Device to compute on; JAX's choice if left out.
        json: Print one JSON object instead of the table.
    """
    if again < 0:
        raise ConfigError(f"--again {again}: must be 0 or more")
    choose_device(device, distributed=False)
    keep_all_programs()
    from angler_mjx.cli.shared.inputs import require_positive
    from angler_mjx.cli.shared.progress import ProgressBar
    from angler_mjx.learning.datasets.verifying import verification

    count = require_positive("workers", workers)
    with ProgressBar(quiet=json) as bar:
        report = verification.verify_dataset(dataset, again, bar, count)
    if json:
        print(text.dumps(report.table()))
    else:
        for finding in report.findings[:MAX_FINDINGS]:
            print(finding.line())
        if (n_hidden := len(report.findings) - MAX_FINDINGS) > 0:
            print(f"... and {n_hidden} more; --json holds all of them")
        for check in report.checks:
            print(check.line())
    if not report.agrees:
        sys.exit(1)


def repair_dataset(
    dataset: Annotated[Path, tyro.conf.Positional],
    accept: bool = False,
    device: Device | None = None,
) -> None:
    """Fly damaged or lost episodes of a dataset again; whole ones are kept.

    Args:
        dataset: Dataset folder.
        accept: Keep flights that differ from before, on another device or version.
        device: Device to compute on; JAX's choice if left out.
    """
    choose_device(device, distributed=False)
    keep_all_programs()
    from angler_mjx.cli.shared.progress import ProgressBar
    from angler_mjx.learning.datasets.maintenance import repair as keeping

    with ProgressBar() as bar:
        result = keeping.repair_dataset(dataset, bar, accept=accept)
    if not result.damaged:
        print("nothing is damaged")
        return
    print(f"{len(result.damaged)} files were damaged or lost, {result.damaged[0]} first")
    print(f"flown again: {', '.join(result.parts) or 'nothing'}")
    if result.other:
        print(f"{len(result.other)} files have other bytes than before, {result.other[0]} first")


def merge_datasets(datasets: Annotated[tuple[Path, ...], tyro.conf.Positional], out: Path) -> None:
    """Merge datasets that were recorded with the same settings.

    Args:
        datasets: Dataset folders.
        out: Folder to make; files are linked into it where the file system allows.
    """
    from angler_mjx.learning.datasets import manifest
    from angler_mjx.learning.datasets.maintenance import merge as keeping

    dataset_path = keeping.merge_datasets(datasets, out)
    _print_dataset(dataset_path, manifest.read_manifest(dataset_path))


def show_stats(
    dataset: Annotated[Path, tyro.conf.Positional],
    json: Annotated[bool, tyro.conf.arg(name="json")] = False,
) -> None:
    """Print counts of a dataset: splits, experts, outcomes, and means and deviations of fields.

    Args:
        dataset: Dataset folder.
        json: Print one JSON object instead of tables.
    """
    from rich.console import Console

    from angler_mjx.cli.shared.text_table import build_text_table as text_table
    from angler_mjx.errors import format_bytes
    from angler_mjx.learning.datasets.maintenance import summary

    counts_by_name = summary.compute_stats(dataset)
    if json:
        print(text.dumps(counts_by_name))
        return
    console = Console()
    console.print(
        f"{counts_by_name['name']}: {counts_by_name['episodes']:,} episodes, "
        f"{counts_by_name['chosen']:,} of them chosen, "
        f"{counts_by_name['robots']:,} robots, "
        f"{format_bytes(counts_by_name['bytes'])}"
    )
    for column, groups in counts_by_name["by"].items():
        table = text_table(column, "episodes", "robots with a plan", "whole teams that arrive")
        for name, group in groups.items():
            percents = (f"{100 * x:.1f} %" for x in (group["planned"], group["success"]))
            table.add_row(name, f"{group['episodes']:,}", *percents)
        console.print(table)
    table = text_table("robots that ended by", "number", "share")
    total = sum(counts_by_name["outcomes"].values())
    for name, count in sorted(counts_by_name["outcomes"].items(), key=lambda item: -item[1]):
        table.add_row(name, f"{count:,}", f"{100 * count / total:.1f} %")
    console.print(table)
    table = text_table("of episodes", "10 %", "median", "90 %")
    for name, quantiles in counts_by_name["quantiles"].items():
        numbers = (quantiles["p10"], quantiles["p50"], quantiles["p90"])
        table.add_row(name, *(f"{number:.3g}" for number in numbers))
    console.print(table)
    table = text_table("field", "mean", "standard deviation")
    rows = list(counts_by_name["fields"].items())
    for vehicle, fields in counts_by_name["fields_by_vehicle"].items():
        rows += [(f"{name} of {vehicle}", value) for name, value in fields.items()]
    for name, moments in rows:
        table.add_row(name, _format_numbers(moments["mean"]), _format_numbers(moments["std"]))
    console.print(table)


def _format_numbers(values: list[float | None]) -> str:
    return " ".join("-" if value is None else f"{value:.3g}" for value in values)


def export_dataset(
    dataset: Annotated[Path, tyro.conf.Positional],
    to: Literal["lerobot", "minari", "mpinets", "parquet"],
    out: Path,
    action: Literal["target", "pwm"] = "target",
    split: str | None = None,
    success: bool | None = None,
) -> None:
    """Write a dataset in the format of another library, with each robot's flight as an episode.

    Args:
        dataset: Dataset folder, or a run folder.
        to: Format: LeRobot 3.0, Minari, the HDF5 of motion policy networks, or plain Parquet.
        out: Folder to make.
        action: Action of the robots: targets of their controllers, or pulse widths.
        split: Export only this split.
        success: Export only episodes in which the whole team arrived (--success), or only the
            others.
    """
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn

    from angler_mjx.cli.shared.consoles import make_progress_console
    from angler_mjx.learning.datasets.exports import formats

    columns = ("flights", BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=make_progress_console()) as bar:
        task = bar.add_task("flights", total=None)
        written_path = formats.export_dataset(
            dataset,
            out,
            to=to,
            action=action,
            split=split,
            success=success,
            progress=lambda done, total: bar.update(task, completed=done, total=total),
        )
    print(written_path)
