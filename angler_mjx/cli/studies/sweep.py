"""`angler sweep`: a scenario over a grid of settings."""

import json as text
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from angler_mjx.cli.shared.device import (
    Device,
    Kernels,
    choose_device,
    join_processes,
    keep_all_programs,
)

if TYPE_CHECKING:
    from angler_mjx.studies.rows import SweepResults


def sweep(
    scenario: Annotated[str, tyro.conf.Positional],
    set: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = (),
    out: Path | None = None,
    worlds: int | None = None,
    seed: int | None = None,
    engine: Literal["mjx", "fused"] | None = None,
    kernels: Kernels | None = None,
    tile: int | None = None,
    record_hz: float = 0.0,
    resume: bool = False,
    device: Device | None = None,
    devices: int | None = None,
    workers: int | None = None,
    distributed: bool = False,
    coordinator: str | None = None,
    processes: int | None = None,
    process: int | None = None,
    json: Annotated[bool, tyro.conf.arg(name="json")] = False,
) -> None:
    """Run a scenario with every combination of some settings, in the same worlds.

    Args:
        scenario: Name of a shipped scenario, or path of a scenario file (.toml).
        set: KEY=VALUE,VALUE,... once for each varied key: a dotted key of scenario files such as
            fleet.0.count=1,2,4, and values as in the file.
        out: Folder to make; runs/NAME-sweep if left out.
        worlds: Number of worlds of each cell; the scenario's if left out.
        seed: Seed of the worlds, of all cells; the scenario's if left out.
        engine: Physics engine; the scenario's if left out. fused is faster, for rigid vehicles.
        kernels: Compiler of the fused engine; if left out, cuda on a GPU, else xla. triton
            means cuda, until 1.0.
        tile: Worlds in one device call; part of the results' bytes.
        record_hz: Rate of the stored trajectories; none are stored if left out.
        resume: Continue an interrupted sweep; all other arguments must be the same.
        device: Device to compute on; JAX's choice if left out.
        devices: Number of devices to spread the worlds over; all available if left out. Changes no
            byte of the results.
        workers: Number of planning processes, for planners on the host; one for each processor if
            left out. Changes no byte of the results.
        distributed: Share the run of each cell with other processes, here or on other hosts; each
            is started with the same arguments and sees the same folder.
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
    from angler_mjx.cli.shared.inputs import build_scenario, require_plans, require_positive
    from angler_mjx.cli.shared.progress import ProgressBar
    from angler_mjx.runs.processes import reporting_failure
    from angler_mjx.runs.storage import planning_summary
    from angler_mjx.studies import sweep as sweeping
    from angler_mjx.studies import sweep_axes

    with reporting_failure(process_group):
        axes = sweep_axes.parse_axes(set)
        loaded = build_scenario(
            scenario,
            worlds=worlds,
            seed=seed,
            engine=engine,
            kernels=kernels,
            tile=tile,
            time={"record_hz": record_hz},
        )
        request = sweeping.build_request(loaded, axes, scenario)
    out_path = out or Path("runs") / f"{loaded.name}-sweep"
    with ProgressBar(quiet=json or process_group.index > 0) as bar:
        results = sweeping.run_sweep(
            request,
            out_path,
            progress=bar,
            resume=resume,
            devices=devices,
            workers=require_positive("workers", workers),
            processes=process_group,
        )
    process_group.leave()
    if process_group.index == 0:
        _print_sweep(results, out_path, as_json=json)
    if not results["complete"]:
        print(f"interrupted; go on with --resume --out {out_path}", file=sys.stderr)
        sys.exit(130)
    if all(planning_summary.planner_fault(row.get("planning")) for row in results["cells"]):
        require_plans(results["cells"][0]["planning"], "in every cell the planner")


def _print_sweep(results: "SweepResults", path: Path, *, as_json: bool) -> None:
    """Print the end of a sweep: one JSON object, or the tables and the path of the folder."""
    if as_json:
        print(text.dumps({**results, "sweep": str(path)}))
        return
    from rich.console import Console

    from angler_mjx.cli.shared.text_table import build_text_table as text_table
    from angler_mjx.studies import tables

    console = Console()
    titles = (f"{results['scenario']}: {results['worlds']:,} worlds a cell", "what changes, paired")
    for title, table in zip(
        titles, (tables.cells_table(results), tables.pairs_table(results)), strict=True
    ):
        for i, (header, rows) in enumerate(tables.fit_to_width(table, console.width)):
            name = title if i == 0 else None
            printed = text_table(*header, fixed=0, title=name, title_justify="left")
            for row in rows:
                printed.add_row(*row)
            console.print(printed)
    for line in tables.without_plans(results):
        print(line)
    print(path / "sweep.md")
