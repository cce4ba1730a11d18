"""`angler benchmark`: comparison of planners."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from angler_mjx.cli.shared.device import Device, choose_device, keep_all_programs
from angler_mjx.errors import ConfigError, RunError

if TYPE_CHECKING:
    from angler_mjx.planning.host.pool import Pool
    from angler_mjx.studies.benchmark.folder_comparison import FolderComparison


def benchmark(
    source: Annotated[Path, tyro.conf.Positional],
    out: Path | None = None,
    presets: tuple[str, ...] | None = None,
    teams: tuple[int, ...] | None = None,
    problems: int | None = None,
    planner: tuple[str, ...] | None = None,
    workers: int | None = None,
    ray: str | None = None,
    resume: bool = False,
    report: bool = False,
    device: Device | None = None,
) -> None:
    """Compare planners on the same problems, and evaluate the flights of their plans.

    Args:
        source: Name of a shipped benchmark (reference, fleets), or a benchmark file (.toml); or the
            results folder of a benchmark, which is made again and compared with the old results.
        out: Results folder to make; runs/NAME if left out.
        presets: World presets; the file's if left out.
        teams: Numbers of robots; the file's if left out.
        problems: Worlds of each preset, scene, team and seed; the file's if left out.
        planner: Planners to compare, in place of the file's: labels and names of its entries, names
            of angler plan --list, FILE.py:CLASS of a planner or policy, or mppi.
        workers: Number of planning processes; one for each processor if left out.
        ray: Address of a Ray cluster whose processors plan (ray start --head prints it), such as
            127.0.0.1:6379.
        resume: Go on with a benchmark that was interrupted; nothing is done twice.
        report: Only make the tables, figures and page of a results folder again.
        device: Device of the flights; JAX's choice if left out.
    """
    choose_device(device)
    keep_all_programs()
    from angler_mjx.cli.shared.inputs import require_positive
    from angler_mjx.shipped import find_shipped
    from angler_mjx.studies.benchmark import running

    if report:
        if out or workers or ray or resume or presets or teams or problems or planner:
            raise ConfigError("--report: makes the page of a results folder; leave out other flags")
        print(running.rebuild_report(source))
        return
    source = find_shipped(source, "angler_mjx.studies.benchmark", "benchmark", folders=True)
    filters = {"presets": presets, "teams": teams, "problems": problems}
    study = running.read_benchmark(
        source,
        planners=planner,
        **{key: x for key, x in filters.items() if x is not None},
    )
    name = f"{study.config.name}-again" if source.is_dir() else study.config.name
    out_path = out or Path("runs") / name
    if source.is_dir() and resume and (out_path / "about.json").is_file():
        _print_comparison(source, out_path)
        return
    for line in study.list_blind_planners():
        print(line, file=sys.stderr)
    from angler_mjx.cli.shared.progress import ProgressBar

    pool = _build_pool(require_positive("workers", workers), ray)
    with ProgressBar() as bar:
        try:
            running.run_benchmark(
                study, source, out_path, workers=pool, resume=resume, progress=bar
            )
        except KeyboardInterrupt:
            print(f"interrupted: go on with --resume --out {out_path}", file=sys.stderr)
            sys.exit(130)
    print(running.format_summary(out_path))
    print(out_path / "report.html")
    if reason := running.find_planning_fault(out_path):
        raise RunError(f"every planner raised; the first {reason}")
    if source.is_dir():
        _print_comparison(source, out_path)


def _print_comparison(first: Path, second: Path) -> None:
    """Print whether two results folders are equal; exit with 1 if not."""
    from angler_mjx.studies.benchmark import folder_comparison

    compared = folder_comparison.compare_folders(first, second)
    print(_format_comparison(compared))
    if not compared.same:
        sys.exit(1)


def _build_pool(workers: int | None, address: str | None) -> "Callable[[], Pool]":
    import os

    def build_local() -> "Pool":
        from angler_mjx.planning.host.workers import Workers

        return Workers(None, workers or os.cpu_count() or 1)

    def build_remote() -> "Pool":
        from angler_mjx.planning.host.cluster.ray_workers import RayWorkers

        return RayWorkers(address or "", workers)

    return build_local if address is None else build_remote


def _format_comparison(compared: "FolderComparison") -> str:
    lines = ["the same" if compared.same else "not the same"]
    for label, one in compared.planners.items():
        slower = "" if one.slower is None else f"; {one.slower:.2f} times its planning time"
        alone = f"; {one.only_one} in one folder only" if one.only_one else ""
        other = one.same_plans_other_outcomes
        flown = f"; {other} with the same plans ended otherwise" if other else ""
        lines.append(
            f"  {label}: {one.same_plans} of {one.runs} runs have the same plans, "
            f"{one.same_outcomes} the same outcomes{flown}{alone}{slower}"
        )
    if not compared.same:
        lines.append(
            "A search that the clock ends gives other plans each time: see docs/how_to/benchmark.md"
        )
    return "\n".join(lines)
