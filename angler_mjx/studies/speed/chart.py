"""What a file of rows looks like: a chart of throughput over worlds, and a table in Markdown."""

import math
from collections import defaultdict
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from angler_mjx.errors import ConfigError
from angler_mjx.report.plotting import series, style
from angler_mjx.report.viewing import markdown_tables
from angler_mjx.runs.simulator.compilation import CompileTime
from angler_mjx.studies.speed import rows as speed
from angler_mjx.studies.speed.compare import host_name, select_latest

BEGIN, END = "<!-- rows: begin -->", "<!-- rows: end -->"
"""What stands between them in a document is replaced by the table."""
COMPILED = ("<!-- compiled: begin -->", "<!-- compiled: end -->")
"""The same of the seconds of compiling."""
COUNTED = ("loops as often as they run", "branches as the cheapest")
"""What rows say of operations that are counted by today's definition."""
_FMA = "fma_flops_per_s"
_UNIT = "vehicle-steps/s"


type Machine = tuple[Any, ...]


def plot_rows(path: Path) -> Figure:
    """Throughput of simulations over the number of worlds, both axes logarithmic.

    Args:
        path: file of rows; the last of each workload, size, engine and device is taken.

    Raises:
        ConfigError: it holds no simulation.
    """
    rows = [
        row for row in select_latest(with_bounds(speed.read_rows(path))) if row["unit"] == _UNIT
    ]
    if not rows:
        raise ConfigError(f"--chart {path}: holds no row in {_UNIT}")
    lines: dict[tuple[str, ...], list[dict[str, Any]]] = defaultdict(list)
    for row in sorted(rows, key=lambda row: row["worlds"]):
        lines[_series_key(row)].append(row)
    best = max(rows, key=lambda row: row["median"])
    with style.titled_figure(
        9.6,
        5.6 + 0.12 * len(lines),
        f"Up to {format_rate(best['median'])} vehicle-steps/s",
        f"{best['workload']}, {_engine_name(best)}, {best['worlds']:,} worlds x "
        f"{best['robots']} on "
        f"{device_name(best)}; medians, bars from least to greatest",
    ) as figure:
        axes = figure.subplots()
        for index, (name, series_rows) in enumerate(sorted(lines.items())):
            _plot_line(axes, index, name, series_rows)
        _plot_rooflines(axes, rows)
        _format_axes(axes)
        figure.legend(loc="outside lower left", ncols=2, handlelength=2.4)
    return figure


def format_table(path: Path) -> str:
    """The rows of a file as a table in Markdown: the last of each workload, size and device.

    Args:
        path: file of rows.
    """
    head = ["workload", "engine", "device", "worlds x robots", "median", "spread"]
    head += ["of the roofline", "flops; bytes", "compile", "commit"]
    rows = sorted(
        (
            row
            for row in select_latest(with_bounds(speed.read_rows(path)))
            if row["unit"] != speed.DURATION
        ),
        key=lambda row: (*_series_key(row), row["worlds"]),
    )
    return markdown_tables.format_table(head, map(_table_row, rows), text=(0, 1, 2, 9))


def compile_table(path: Path) -> str:
    """Seconds of compiling in a file of rows, as a table in Markdown; empty without any.

    Args:
        path: file of rows; the last of each scenario, size, engine and host is taken.

    Returns:
        A line for each scenario, size, engine, device and host, with a column for each program:
        seconds with an empty cache folder, then from a full one.
    """
    lines: dict[tuple[str, ...], dict[str, str]] = defaultdict(dict)
    for row in select_latest(speed.read_rows(path)):
        if row["unit"] == speed.DURATION:
            _, scenario, *rest = row["workload"].split("/")
            size = f"{row['worlds']:,} x {row['robots']}"
            size_row = lines[scenario, _engine_name(row), device_name(row), host_name(row), size]
            size_row["/".join(rest)] = f"{row['median']:.1f}"
            jax = (row.get("versions") or {}).get("jax", "-")
            size_row["at"] = f"{jax} | {str(row['at_utc'])[:10]} | {_short_commit(row)}"
    if not lines:
        return ""
    programs = tuple(CompileTime().by_program())
    head = ["scenario", "engine", "device", "host", "worlds x robots", *programs]
    head += ["all, side by side", "jax", "date", "commit"]
    body = [
        [*name, *_format_seconds(size_row, programs), size_row["at"]]
        for name, size_row in sorted(lines.items())
    ]
    return markdown_tables.format_table(head, body)


def _format_seconds(size_row: dict[str, str], programs: tuple[str, ...]) -> list[str]:
    """Cold and cached seconds of each program and of all."""
    cached = [(name, f"{name}/cached".removeprefix("/")) for name in (*programs, "")]
    return [f"{size_row.get(cold, '-')}; {size_row.get(warm, '-')}" for cold, warm in cached]


def write_table(path: Path, document: Path) -> None:
    """Put the tables of a file between the marks of a document.

    Raises:
        ConfigError: the document cannot be read or written, or has no marks.
    """
    begin, end = COMPILED
    seconds = compile_table(path)
    if seconds:
        markdown_tables.require_marks(document, begin, end)
    markdown_tables.replace_section(document, BEGIN, format_table(path), END)
    if seconds:
        markdown_tables.replace_section(document, begin, seconds, end)


def _series_key(row: dict[str, Any]) -> tuple[str, ...]:
    return (row["workload"], _engine_name(row), device_name(row), f"{row['robots']:4d}")


def _plot_line(axes: Axes, index: int, name: tuple[str, ...], rows: list[dict[str, Any]]) -> None:
    workload, engine, device, robots = name
    look = series.line_style(index)
    worlds = [row["worlds"] for row in rows]
    median = [row["median"] for row in rows]
    below = [row["median"] - row["low"] for row in rows]
    above = [row["high"] - row["median"] for row in rows]
    axes.errorbar(
        worlds,
        median,
        yerr=[below, above],
        **look,
        marker=series.MARKERS[index % len(series.MARKERS)],
        markersize=5.5,
        # Where colours repeat: single points have no line that could tell them apart.
        markerfacecolor=style.PAPER if series.is_repeated(index) else look["color"],
        linewidth=1.8,
        capsize=2.5,
        label=f"{workload}, {_format_robots(int(robots))}, {engine}, {device}",
    )


def _plot_rooflines(axes: Axes, rows: list[dict[str, Any]]) -> None:
    """What memory and arithmetic allow, by workload and device; of several engines the highest.

    Only of those measured at several sizes: lines for single points would hide one another.
    """
    bounds: dict[tuple[str, str], float] = {}
    sizes: dict[tuple[str, str], set[int]] = {}
    for row in rows:
        name = (row["workload"], device_name(row))
        bounds[name] = max(bounds.get(name, 0.0), row.get("bound") or 0.0)
        sizes.setdefault(name, set()).add(row["worlds"])
    above, left = math.inf, True
    for (workload, device), bound in sorted(bounds.items(), key=lambda item: -item[1]):
        if not bound or len(sizes[workload, device]) < 2:
            continue
        axes.axhline(bound, color=style.QUIET, linestyle=":", linewidth=1.2)
        # Where lines lie close together: below the lower one, in turn on the right and on the left.
        close = above <= 1.8 * bound
        left = not (close and left)
        axes.text(
            0.01 if left else 0.27,
            bound * (0.94 if close else 1.06),
            f"roofline: {workload}, {device}",
            transform=axes.get_yaxis_transform(),
            va="top" if close else "bottom",
            fontsize=8.0,
            color=style.QUIET,
        )
        above = bound


def _format_axes(axes: Axes) -> None:
    axes.set_xscale("log", base=2)
    axes.set_yscale("log")
    low, high = axes.get_ylim()
    axes.set_ylim(low / 1.5, high * 1.5)
    ticks = [4**k for k in range(11)]
    left, right = axes.get_xlim()
    shown = [tick for tick in ticks if left <= tick <= right]
    axes.set_xticks(shown, [f"{tick:,}" for tick in shown])
    axes.set_xticks([], minor=True)
    axes.set_xlabel("worlds in one device call")
    axes.set_ylabel("physics steps of vehicles in a second")
    axes.grid()


def _table_row(row: dict[str, Any]) -> list[str]:
    spread = (row["high"] - row["low"]) / row["median"]
    bound_percent = _format_percent(100 * row["median"] / row["bound"]) if row.get("bound") else "-"
    counted = f"{row['flops']:,.0f}" if row["flops"] else "-"
    moved = f"{row['least_bytes']:.3g}" if row["least_bytes"] else "-"
    compiled = f"{row['compile_s']:.1f} s" if row["compile_s"] is not None else "-"
    compiled += " (cached)" if row["cached_programs"] else ""
    return [
        row["workload"],
        _engine_name(row),
        device_name(row),
        f"{row['worlds']:,} x {row['robots']}",
        f"{format_rate(row['median'])} {row['unit']}",
        f"{100 * spread:.0f} %",
        bound_percent,
        f"{counted}; {moved}",
        compiled,
        _short_commit(row),
    ]


def _engine_name(row: dict[str, Any]) -> str:
    if row["engine"] is None:
        return "-"
    return f"{row['engine']}/{row['kernels']}" if row["engine"] == "fused" else str(row["engine"])


def _short_commit(row: dict[str, Any]) -> str:
    commit = str(row["commit"] or "-")
    return commit[:7] + (" (changed)" if commit.endswith("-changed") else "")


def device_name(row: dict[str, Any]) -> str:
    """Devices of a row as a person names them: CPU, H200, 4 H200."""
    name = "CPU" if row["device"] == "cpu" else str(row["device"]).removeprefix("NVIDIA ")
    return name if row["devices"] == 1 else f"{row['devices']} {name}"


def _format_robots(number: int) -> str:
    return "1 robot" if number == 1 else f"{number} robots"


def _format_percent(percent: float) -> str:
    """Two digits, or as many as a whole number has."""
    return f"{percent:.0f} %" if percent >= 10 else f"{percent:.2g} %"


def format_rate(rate: float) -> str:
    """As 1.2e8, without the zero and sign that Python puts into an exponent."""
    mantissa, exponent = f"{rate:.1e}".split("e")
    return f"{mantissa}e{int(exponent)}" if abs(int(exponent)) > 3 else f"{rate:.0f}"


def with_bounds(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return rows with ``bound`` by one definition of the roofline: the highest rate, or None.

    A row keeps the bound of its own day: with the limits of its device as they were measured then,
    and with the operations as they were counted then. Both have become better known. In a table or
    a chart the limits of a device are the greatest that any row measured on it, and operations
    count where they were counted as `angler_mjx.studies.speed.flops` does now; other rows have no
    bound.
    """
    copies, multiply_adds = (
        _greatest_by_machine(rows, name) for name in ("copy_bytes_per_s", _FMA)
    )
    return [{**row, "bound": _row_bound(row, copies, multiply_adds)} for row in rows]


def _row_bound(
    row: dict[str, Any], copies: dict[Machine, float], multiply_adds: dict[Machine, float]
) -> float | None:
    machine = _machine_key(row)
    counted = str(row["flops_from"] or "")
    if machine not in copies or not any(text in counted for text in COUNTED):
        return None
    limits = []
    if row["flops"]:
        if machine not in multiply_adds:
            return None
        limits.append(multiply_adds[machine] / row["flops"])
    if row["least_bytes"]:
        limits.append(copies[machine] / row["least_bytes"])
    return row["devices"] * min(limits) if limits else None


def _greatest_by_machine(rows: list[dict[str, Any]], name: str) -> dict[Machine, float]:
    greatest: dict[Machine, float] = {}
    for row in rows:
        if row.get(name):
            greatest[_machine_key(row)] = max(greatest.get(_machine_key(row), 0.0), row[name])
    return greatest


def _machine_key(row: dict[str, Any]) -> Machine:
    """A GPU by its name; processors are all named "cpu", so by their cores as well."""
    cpu = row["device"] == "cpu"
    return (row["device"], row.get("cpu_count") if cpu else None)
