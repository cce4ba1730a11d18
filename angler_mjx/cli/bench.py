"""`angler bench`: how fast this machine is, as a table and as JSON lines; and what became of it."""

from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from angler_mjx.cli.shared.device import Device, choose
from angler_mjx.errors import ConfigError, RunError

if TYPE_CHECKING:
    from angler_mjx.studies.speed.rows import SpeedRow

RESULTS = Path("benchmarks/results.jsonl")
CHART = Path("docs/images/performance.png")


def bench(
    workload: tuple[str, ...] = (),
    scenario: tuple[str, ...] = (),
    worlds: tuple[int, ...] = (),
    robots: tuple[int, ...] = (),
    engine: Literal["mjx", "fused"] | None = None,
    kernels: Literal["xla", "triton"] | None = None,
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
    """Measure how fast this machine is; or compare, draw or tabulate what was measured.

    Args:
        workload: dynamics, closed_loop_8, reef_fleet, mjx, recording, preparation, env_generation,
            clearance, compile, or scenarios by name or path, several after one another; the
            profile's if left out.
        scenario: Scenarios that --workload compile compiles, by name or path; all shipped ones if
            left out.
        worlds: Worlds in one device call; one row for each number, as in --worlds 64 1024;
            the profile's if left out, of compile those of a run of the scenario.
        robots: Robots in each world, as in --robots 1 4 16; the workload's own if left out, and
            always one in dynamics.
        engine: Engine of the simulations; the workload's own if left out.
        kernels: What the fused engine is compiled by.
        controller: Controllers of the simulations by name, one row for each, as in --controller
            cascade tracking; the scenario's own if left out.
        profile: Workloads and sizes where none are given: quick takes minutes on a laptop, full
            and paper want a GPU.
        repeats: Timed calls of each row, at least 10.
        device: Where to compute; JAX's choice if left out.
        devices: Devices for the simulations; each has as many worlds as are asked for.
        out: File to write: of rows (appended; benchmarks/results.jsonl if left out), the picture
            of --chart, or the document of --table. recording writes to the disk it stands on.
        compare: Two files of rows, or two commits with rows in --out: print second over first.
        chart: Draw a file of rows.
        table: Print a file of rows as Markdown, or put it into the document --out.
    """
    if [compare, chart, table].count(None) < 2:
        raise ConfigError("--compare, --chart, --table: give one of them")
    if compare is not None:
        _compare(*compare, out or RESULTS)
    elif chart is not None:
        _chart(chart, out or CHART)
    elif table is not None:
        _table(table, out)
    else:
        choose(device)
        from angler_mjx.studies.speed.workloads import SpeedRequest

        asked = SpeedRequest(
            profile=profile,
            workloads=workload,
            scenarios=scenario,
            worlds=worlds,
            robots=robots,
            engine=engine,
            kernels=kernels,
            controllers=controller,
            repeats=repeats,
            devices=devices,
            folder=(out or RESULTS).parent,
        )
        _measure(asked, out or RESULTS)


def _measure(asked: Any, out: Path) -> None:
    from rich.console import Console

    from angler_mjx.studies.speed import measuring, roofline, workloads
    from angler_mjx.studies.speed.report import around, complete
    from angler_mjx.studies.speed.rows import record

    chosen = workloads.cases(asked)
    console = Console(stderr=True)
    console.print("the device itself ...", style="dim")
    device = roofline.measure()
    print(
        f"device: copies {device.copy_bytes_per_s:.3g} bytes/s, "
        f"{device.fma_flops_per_s:.3g} multiply-add flops/s, both measured"
    )
    about = around(device)

    def begin(case: Any) -> None:
        console.print(f"{case.label}, {case.worlds} x {case.robots} ...", style="dim")

    rows = []
    for row in measuring.run(chosen, begin):
        record(row, {**about, **complete(row, device)}, out)
        rows.append(row)
    _show(rows, device)
    print(out)
    refused = [row for row in rows if row.refused and not row.out_of_memory]
    if refused:
        raise RunError(f"{len(refused)} of {len(rows)} rows were refused; the reasons stand above")


def _show(rows: "list[SpeedRow]", device: Any) -> None:
    from rich.console import Console

    from angler_mjx.cli.shared.text_table import table as text_table
    from angler_mjx.studies.speed.report import complete

    shown = text_table("workload", "worlds x robots", "median (spread)", "of roofline", "compile")
    console = Console()
    seconds = [row for row in rows if row.unit == "s"]
    rates = [row for row in rows if row.unit != "s"]
    for row in rates:
        engine = "/".join(part for part in (row.engine, row.kernels) if part)
        size = _size(row)
        if row.median is None or row.low is None or row.high is None:
            shown.add_row(f"{row.workload}\n{engine}", size, "refused, see below", "", "")
            continue
        share = complete(row, device)["share_of_bound"]
        shown.add_row(
            f"{row.workload}\n{engine}",
            size,
            f"{row.median:.2e} ({(row.high - row.low) / row.median:.0%})\n{row.unit}",
            "" if share is None else f"{share:.1%}",
            _compiled(row),
        )
    if rates:
        console.print(shown)
    if seconds:
        console.print(_seconds(seconds))
    said = dict.fromkeys(f"{_name(row)}: timed is {row.inside}" for row in rows if row.inside)
    said |= {
        _recorded(row): None for row in rows if row.workload.startswith("recording/") and row.extra
    }
    refusals = [f"{r.workload}, {r.worlds} x {r.robots}: {r.refused}" for r in rows if r.refused]
    for line in [*said, *refusals]:
        console.print(line, highlight=False)


def _seconds(rows: "list[SpeedRow]") -> Any:
    """A table of the seconds of compiling, cold and cached side by side."""
    from angler_mjx.cli.shared.text_table import table as text_table

    shown = text_table("workload", "worlds x robots", "empty cache", "full cache")
    of: dict[tuple[str, ...], list[str]] = {}
    for row in rows:
        engine = "/".join(part for part in (row.engine, row.kernels) if part)
        name = (row.workload.removesuffix("/cached"), engine, _size(row))
        of.setdefault(name, []).append(f"{row.median:.2f} s")
    for (workload, engine, size), both in of.items():
        shown.add_row(f"{workload} {engine}", size, *both)
    return shown


def _name(row: "SpeedRow") -> str:
    """Workload of a row; of seconds, whose rows are timed alike, without scenario and program."""
    return row.workload.partition("/")[0] if row.unit == "s" else row.workload


def _recorded(row: "SpeedRow") -> str:
    """What a row of recording has to say beside its rate."""
    x = row.extra
    return (
        f"{row.workload}, {_size(row)}: {x['disk_ratio']:.0%} of what the disk takes, "
        f"{x['disk_mbps']:.0f} MB/s (spread {x['disk_spread']:.0%}); {x['samples_mbps']:.0f} MB/s "
        f"of samples before compression, {x['bytes_per_robot_sample']:.1f} bytes for a robot's "
        f"sample; at {x['vehicle_steps_per_s']:.2e} vehicle-steps/s the device would wait for the "
        f"disk above {x['break_even_hz']:.3g} Hz of simulated time"
    )


def _size(row: Any) -> str:
    """Worlds and robots of a row or a ratio."""
    size = f"{row.worlds:,} x {row.robots}"
    return size if row.devices == 1 else f"{row.devices} devices x {size}"


def _compiled(row: "SpeedRow") -> str:
    if row.compile_s is None:
        return ""
    return f"{row.compile_s:.1f} s" + (" (cached)" if row.cached_programs else "")


def _compare(a: str, b: str, results: Path) -> None:
    from rich.console import Console

    from angler_mjx.cli.shared.text_table import table as text_table
    from angler_mjx.studies.speed.compare import compare

    shown = text_table("workload", "worlds x robots", a, b, "ratio", "by the repeats")
    found = compare(a, b, results)
    for row in found.ratios:
        engine = "/".join(part for part in (row.engine, row.kernels) if part)
        shown.add_row(
            f"{row.workload} {engine}".strip(),
            _size(row),
            _compared(row.before, row.unit),
            _compared(row.after, row.unit),
            f"{row.ratio:.3f}",
            _by_the_repeats(row),
        )
    console = Console()
    console.print(shown)
    for line in [found.machines, *(f"left out: {line}" for line in found.left_out)]:
        if line:
            console.print(line, highlight=False)


def _compared(median: float, unit: str) -> str:
    return f"{median:.2f} s" if unit == "s" else f"{median:.2e} {unit}"


def _by_the_repeats(row: Any) -> str:
    """Least and greatest ratio that the repeats allow; of one repeat nothing can be said."""
    if row.repeats == 1:
        return "measured once"
    return f"{row.low:.2f} to {row.high:.2f}" + ("" if row.beyond_spread else ": no difference")


def _chart(rows: Path, out: Path) -> None:
    from angler_mjx.report.viewing import style
    from angler_mjx.studies.speed import chart

    style.save(chart.draw(rows), out)
    print(out)


def _table(rows: Path, out: Path | None) -> None:
    from angler_mjx.studies.speed import chart

    if out is None:
        print("\n\n".join(filter(None, (chart.table(rows), chart.compile_table(rows)))))
        return
    chart.write_table(rows, out)
    print(out)
