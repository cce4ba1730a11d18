"""`angler bench`: speed of this machine, as a table and as JSON lines; comparison and charts."""

from pathlib import Path
from typing import TYPE_CHECKING, Literal

from angler_mjx.cli.shared.device import Device, Kernels, choose_device
from angler_mjx.errors import ConfigError, RunError

if TYPE_CHECKING:
    from rich.table import Table

    from angler_mjx.studies.speed.compare import SpeedRatio
    from angler_mjx.studies.speed.roofline import DeviceSpeed
    from angler_mjx.studies.speed.rows import SpeedRow
    from angler_mjx.studies.speed.workloads import SpeedRequest, WorkloadCase

RESULTS_PATH = Path("benchmarks/results.jsonl")
CHART_PATH = Path("docs/images/performance.png")


def bench(
    workload: tuple[str, ...] = (),
    scenario: tuple[str, ...] = (),
    worlds: tuple[int, ...] = (),
    robots: tuple[int, ...] = (),
    engine: Literal["mjx", "fused"] | None = None,
    kernels: Kernels | None = None,
    controller: tuple[str, ...] = (),
    profile: Literal["quick", "full", "paper"] = "quick",
    repeats: int = 10,
    device: Device | None = None,
    devices: int = 1,
    out: Path | None = None,
    compare: tuple[str, str] | None = None,
    chart: Path | None = None,
    table: Path | None = None,
) -> None:
    """Measure the speed of this machine; or compare, plot or tabulate measured results.

    Args:
        workload: dynamics, dynamics_arm, closed_loop_8, reef_fleet, mjx, recording, preparation,
            env_generation, clearance, search, compile, or scenarios by name or path, one or
            several; the profile's if left out.
        scenario: Scenarios of --workload compile, by name or path; if left out, all shipped ones,
            or with --profile full and paper some teams and numbers of worlds.
        worlds: Worlds in one device call; one row for each number, as in --worlds 64 1024; the
            profile's if left out, for compile the worlds of a run of the scenario.
        robots: Robots in each world, as in --robots 1 4 16; the workload's own if left out, and
            always one in dynamics.
        engine: Engine of the simulations; the workload's own if left out.
        kernels: Compiler of the fused engine. triton means cuda, until 1.0.
        controller: Controllers of the simulations by name, one row for each, as in --controller
            cascade tracking; the scenario's own if left out.
        profile: Default workloads and sizes: quick takes minutes on a laptop, full and paper need a
            GPU.
        repeats: Timed calls of each row, at least 10.
        device: Device to compute on; JAX's choice if left out.
        devices: Devices for the simulations; each has the requested number of worlds.
        out: File to write: rows (appended; benchmarks/results.jsonl if left out), the image of
            --chart, or the document of --table. recording writes to the disk of this file.
        compare: Two files of rows, or two commits with rows in --out: print second over first.
        chart: Plot a file of rows.
        table: Print a file of rows as Markdown, or insert it into the document --out.
    """
    if [compare, chart, table].count(None) < 2:
        raise ConfigError("--compare, --chart, --table: give one of them")
    if compare is not None:
        _print_comparison(*compare, out or RESULTS_PATH)
    elif chart is not None:
        _save_chart(chart, out or CHART_PATH)
    elif table is not None:
        _print_table(table, out)
    else:
        choose_device(device)
        from angler_mjx.studies.speed.workloads import SpeedRequest

        request = SpeedRequest(
            profile=profile,
            workloads=workload,
            scenarios=scenario,
            worlds=worlds,
            robots=robots,
            engine=engine,
            kernels="cuda" if kernels == "triton" else kernels,
            controllers=controller,
            repeats=repeats,
            devices=devices,
            folder=(out or RESULTS_PATH).parent,
        )
        _run_measurements(request, out or RESULTS_PATH)


def _run_measurements(request: "SpeedRequest", out: Path) -> None:
    from angler_mjx.progress import ProgressLines
    from angler_mjx.studies.speed import roofline, workloads
    from angler_mjx.studies.speed.measured import measuring
    from angler_mjx.studies.speed.roofline import compare_with_bound, describe_conditions
    from angler_mjx.studies.speed.rows import append_row

    cases = workloads.build_cases(request)
    progress = ProgressLines()
    progress.describe("the device itself")
    device = roofline.measure()
    print(
        f"device: copies {device.copy_bytes_per_s:.3g} bytes/s, "
        f"{device.fma_flops_per_s:.3g} multiply-add flops/s, both measured"
    )
    machine = describe_conditions(device)

    def report_case(case: "WorkloadCase") -> None:
        progress.describe(f"{case.label}, {case.worlds} x {case.robots}")

    rows = []
    for row in measuring.measure_cases(cases, report_case, progress):
        append_row(row, {**machine, **compare_with_bound(row, device)}, out)
        rows.append(row)
    _print_rows(rows, device)
    print(out)
    refused = [row for row in rows if row.refused and not row.out_of_memory]
    if refused:
        raise RunError(f"{len(refused)} of {len(rows)} rows were refused; the reasons stand above")


def _print_rows(rows: "list[SpeedRow]", device: "DeviceSpeed") -> None:
    from rich.console import Console

    from angler_mjx.cli.shared.text_table import build_text_table as text_table
    from angler_mjx.studies.speed.roofline import compare_with_bound

    table = text_table("workload", "worlds x robots", "median (spread)", "of roofline", "compile")
    console = Console()
    seconds = [row for row in rows if row.unit == "s"]
    rates = [row for row in rows if row.unit != "s"]
    for row in rates:
        engine = "/".join(part for part in (row.engine, row.kernels) if part)
        size = _format_size(row)
        if row.median is None or row.low is None or row.high is None:
            table.add_row(f"{row.workload}\n{engine}", size, "refused, see below", "", "")
            continue
        fraction = compare_with_bound(row, device)["share_of_bound"]
        table.add_row(
            f"{row.workload}\n{engine}",
            size,
            f"{row.median:.2e} ({(row.high - row.low) / row.median:.0%})\n{row.unit}",
            "" if fraction is None else f"{fraction:.1%}",
            _format_compile_time(row),
        )
    if rates:
        console.print(table)
    if seconds:
        console.print(_build_seconds_table(seconds))
    notes = dict.fromkeys(f"{_row_name(row)}: timed is {row.inside}" for row in rows if row.inside)
    notes |= {
        _format_recording(row): None
        for row in rows
        if row.workload.startswith("recording/") and row.extra
    }
    notes |= {
        f"{row.workload}: machine_factor = {row.extra['time_factor']:.2f} of ANGLER-1": None
        for row in rows
        if "time_factor" in row.extra
    }
    refusals = [f"{r.workload}, {r.worlds} x {r.robots}: {r.refused}" for r in rows if r.refused]
    for line in [*notes, *refusals]:
        console.print(line, highlight=False)


def _build_seconds_table(rows: "list[SpeedRow]") -> "Table":
    """Return a table of the compile times, cold and cached side by side."""
    from angler_mjx.cli.shared.text_table import build_text_table as text_table

    table = text_table("workload", "worlds x robots", "empty cache", "full cache")
    seconds: dict[tuple[str, ...], list[str]] = {}
    for row in rows:
        engine = "/".join(part for part in (row.engine, row.kernels) if part)
        name = (row.workload.removesuffix("/cached"), engine, _format_size(row))
        seconds.setdefault(name, []).append(f"{row.median:.2f} s")
    for (workload, engine, size), medians in seconds.items():
        table.add_row(f"{workload} {engine}", size, *medians)
    return table


def _row_name(row: "SpeedRow") -> str:
    """Return the workload of a row; for compile times without scenario and program."""
    return row.workload.partition("/")[0] if row.unit == "s" else row.workload


def _format_recording(row: "SpeedRow") -> str:
    """Return the details of a recording row beside its rate."""
    x = row.extra
    return (
        f"{row.workload}, {_format_size(row)}: {x['disk_ratio']:.0%} of what the disk takes, "
        f"{x['disk_mbps']:.0f} MB/s (spread {x['disk_spread']:.0%}); {x['samples_mbps']:.0f} MB/s "
        f"of samples before compression, {x['bytes_per_robot_sample']:.1f} bytes for a robot's "
        f"sample; at {x['vehicle_steps_per_s']:.2e} vehicle-steps/s the device would wait for the "
        f"disk above {x['break_even_hz']:.3g} Hz of simulated time"
    )


def _format_size(row: "SpeedRow | SpeedRatio") -> str:
    """Return the worlds and robots of a row or a ratio."""
    size = f"{row.worlds:,} x {row.robots}"
    return size if row.devices == 1 else f"{row.devices} devices x {size}"


def _format_compile_time(row: "SpeedRow") -> str:
    if row.compile_s is None:
        return ""
    return f"{row.compile_s:.1f} s" + (" (cached)" if row.cached_programs else "")


def _print_comparison(a: str, b: str, results: Path) -> None:
    from rich.console import Console

    from angler_mjx.cli.shared.text_table import build_text_table as text_table
    from angler_mjx.studies.speed.compare import compare_rows

    table = text_table("workload", "worlds x robots", a, b, "ratio", "by the repeats")
    comparison = compare_rows(a, b, results)
    for row in comparison.ratios:
        engine = "/".join(part for part in (row.engine, row.kernels) if part)
        table.add_row(
            f"{row.workload} {engine}".strip(),
            _format_size(row),
            _format_median(row.before, row.unit),
            _format_median(row.after, row.unit),
            f"{row.ratio:.3f}",
            _format_interval(row),
        )
    console = Console()
    console.print(table)
    for line in [comparison.machines, *(f"left out: {line}" for line in comparison.left_out)]:
        if line:
            console.print(line, highlight=False)


def _format_median(median: float, unit: str) -> str:
    return f"{median:.2f} s" if unit == "s" else f"{median:.2e} {unit}"


def _format_interval(row: "SpeedRatio") -> str:
    """Return the min and max ratio over the repeats; empty for a single repeat."""
    if row.repeats == 1:
        return "measured once"
    return f"{row.low:.2f} to {row.high:.2f}" + ("" if row.beyond_spread else ": no difference")


def _save_chart(rows: Path, out: Path) -> None:
    from angler_mjx.report.plotting import style
    from angler_mjx.studies.speed import chart

    style.save_figure(chart.plot_rows(rows), out)
    print(out)


def _print_table(rows: Path, out: Path | None) -> None:
    from angler_mjx.studies.speed import chart

    if out is None:
        print("\n\n".join(filter(None, (chart.format_table(rows), chart.compile_table(rows)))))
        return
    chart.write_table(rows, out)
    print(out)
