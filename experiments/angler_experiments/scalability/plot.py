"""Figures and tables of costs, from a file of rows without new measurements.

The command is in docs/generated/scalability.md.
"""

import json
import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter

from angler_experiments.scalability.cost import PREFIX
from angler_experiments.scalability.fits import LinearFit, PowerLawFit, fit_linear, fit_power_law
from angler_experiments.scalability.ladders import BY_NAME, LADDERS
from angler_mjx.errors import ConfigError
from angler_mjx.report.plotting import style
from angler_mjx.report.viewing import markdown_tables
from angler_mjx.studies.speed import rows as speed

BEGIN, END = "<!-- cost: begin -->", "<!-- cost: end -->"
"""Marks in a page between which the tables are replaced."""
STEPS = 100
"""Physics steps of the reported time: a second of simulated time of ours."""
MIN_SPAN = 5.0
"""Least ratio of an axis of costs, from its end to its beginning."""
PUBLISHED_WORLDS = (64, 1024, 16_384, 65_536, 262_144)
"""Numbers of worlds of published rates: other machines, another vehicle.

Crazyflow 0.4.0, table in its README: RTX 4090, first-principles dynamics, one drone in each world.
"""
PUBLISHED_RATES = (1.2e6, 18.7e6, 257e6, 678e6, 914e6)
"""Published rates of these numbers of worlds, vehicle-steps/s."""


@dataclass(frozen=True, kw_only=True)
class MeasuredRow:
    """Measured rates of one size."""

    work: int
    """Vehicle-steps of ``STEPS`` physics steps."""
    median: float
    """Vehicle-steps/s, as the next two."""
    low: float
    high: float
    program_bytes: float | None


@dataclass(frozen=True, kw_only=True)
class PlotLine:
    """Costs of one engine on one device over one ladder."""

    ladder: str
    engine: str
    device: str
    size: tuple[float, ...]
    seconds: tuple[float, ...]
    """Seconds for ``STEPS`` physics steps of all robots, medians."""
    low: tuple[float, ...]
    high: tuple[float, ...]
    bytes: tuple[float | None, ...]
    """Bytes of the program: arguments, results and temporaries; None without a report of XLA."""

    @property
    def time(self) -> PowerLawFit | None:
        """Fit the seconds."""
        return fit_power_law(self.size, self.seconds)

    @property
    def memory(self) -> PowerLawFit | None:
        """Fit the bytes."""
        return fit_power_law(*self.reported_bytes)

    @property
    def reported_bytes(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Return sizes and bytes with a report of XLA."""
        reported = [(x, y) for x, y in zip(self.size, self.bytes, strict=True) if y]
        return tuple(x for x, _ in reported), tuple(y for _, y in reported)


def read_lines(path: Path) -> list[PlotLine]:
    """Read all lines of a file of rows; of several rows of one size the last counts.

    Raises:
        ConfigError: the file cannot be read, or holds no row of a ladder.
    """
    rows_by_line: dict[tuple[str, str, str], dict[float, MeasuredRow]] = defaultdict(dict)
    for row in speed.read_rows(path):
        if row["workload"].startswith(PREFIX) and row["median"] is not None:
            name = row["workload"].removeprefix(PREFIX)
            key = (name, row["engine"], str(row["device"]))
            rows_by_line[key][row["extra"]["size"]] = MeasuredRow(
                work=row["worlds"] * row["robots"] * STEPS,
                median=row["median"],
                low=row["low"],
                high=row["high"],
                program_bytes=row["program_bytes"],
            )
    if not rows_by_line:
        raise ConfigError(f"{path}: holds no row of {PREFIX}*")
    order = {name: i for i, name in enumerate(BY_NAME)}
    return [
        _build_line(*key, rows_by_size)
        for key, rows_by_size in sorted(
            rows_by_line.items(), key=lambda item: (order[item[0][0]], *item[0][1:])
        )
    ]


def _build_line(
    ladder: str, engine: str, device: str, rows_by_size: dict[float, MeasuredRow]
) -> PlotLine:
    size = tuple(sorted(rows_by_size))
    sorted_rows = [rows_by_size[x] for x in size]
    return PlotLine(
        ladder=ladder,
        engine=engine,
        device=device,
        size=size,
        seconds=tuple(row.work / row.median for row in sorted_rows),
        low=tuple(row.work / row.high for row in sorted_rows),
        high=tuple(row.work / row.low for row in sorted_rows),
        bytes=tuple(row.program_bytes for row in sorted_rows),
    )


def format_fits(plot_lines: Sequence[PlotLine]) -> str:
    """Format the fits in Markdown."""
    several = _several_devices(plot_lines)
    head = ["what is varied", "engine", *["device"] * several, "from", "to", f"ms, {STEPS} steps"]
    head += ["exponent of time (95 %)", "of the last step", "fixed, ms", "each more, us"]
    head += ["memory, to", "its exponent (95 %)"]
    body = []
    for plot_line in plot_lines:
        time, linear = plot_line.time, fit_linear(plot_line.size, plot_line.seconds)
        max_bytes = next((x for x in reversed(plot_line.bytes) if x), None)
        body.append(
            [
                BY_NAME[plot_line.ladder].label,
                plot_line.engine,
                *[plot_line.device] * several,
                f"{plot_line.size[0]:,.0f}",
                f"{plot_line.size[-1]:,.0f}",
                f"{1e3 * plot_line.seconds[0]:.3g} to {1e3 * plot_line.seconds[-1]:.3g}",
                format_exponent(time),
                "-" if time is None else f"{time.last:.2f}",
                "-" if linear is None else f"{1e3 * linear.fixed:.3g}",
                "-" if linear is None else f"{1e6 * linear.each:.3g}",
                "-" if max_bytes is None else format_bytes(max_bytes),
                format_exponent(plot_line.memory),
            ]
        )
    return markdown_tables.format_table(head, body)


def _several_devices(plot_lines: Sequence[PlotLine]) -> bool:
    return len({plot_line.device for plot_line in plot_lines}) > 1


def format_exponent(fit: PowerLawFit | None) -> str:
    """Format an exponent with its interval."""
    if fit is None:
        return "-"
    if math.isnan(fit.low):
        return f"{fit.exponent:.2f}"
    return f"{fit.exponent:.2f} ({fit.low:.2f} to {fit.high:.2f})"


def format_bytes(n_byte: float) -> str:
    """Format bytes in GB or MB."""
    return f"{n_byte / 1e9:.3g} GB" if n_byte >= 1e9 else f"{n_byte / 1e6:.3g} MB"


def plot_costs(plot_lines: Sequence[PlotLine], quantity: str) -> Figure:
    """Plot costs on logarithmic axes, a panel for each ladder.

    Args:
        plot_lines: lines to plot.
        quantity: time or memory.
    """
    shown_ladders = [item for item in LADDERS if any(x.ladder == item.name for x in plot_lines)]
    columns = min(3, len(shown_ladders))
    n_rows = -(-len(shown_ladders) // columns)
    kinds = sorted({(item.engine, item.device) for item in plot_lines})
    colors = {kind: style.robot_color(i) for i, kind in enumerate(kinds)}
    device_text = "" if _several_devices(plot_lines) else f"{plot_lines[0].device}; "
    titles = {
        "time": (
            "What more costs in time",
            f"{device_text}ms for {STEPS} physics steps of all robots",
        ),
        "memory": (
            "What more costs in memory",
            f"{device_text}GB of the program, by XLA's account",
        ),
    }[quantity]
    with style.figure_style():
        figure = style.new_figure(11.4, 0.9 + 3.5 * n_rows, headline_in=0.65)
        subtitle = (
            "Lines: a fixed cost and one of each; numbers: exponents (95 %), and of the last step"
        )
        style.add_headline(figure, titles[0], f"{titles[1]}. {subtitle}")
        all_axes = list(figure.subplots(n_rows, columns, squeeze=False).flat)
        for axes, ladder in zip(all_axes, shown_ladders, strict=False):
            axes.set_title(ladder.label, fontsize=10)
            axes.set_xscale("log", base=2)
            axes.set_yscale("log")
            for item in plot_lines:
                if item.ladder == ladder.name:
                    label = f"{item.engine}, {item.device}" if device_text == "" else item.engine
                    _plot_panel(axes, item, quantity, label, colors[item.engine, item.device])
            if ladder.name == "dynamics" and quantity == "time":
                _plot_published(axes)
            _widen_axis(axes)
            axes.grid(True)
            axes.legend(
                fontsize=7.5, loc="upper left", bbox_to_anchor=(0.0, -0.1), borderaxespad=0.0
            )
        for axes in all_axes[len(shown_ladders) :]:
            axes.set_axis_off()
    return figure


class PlainFormatter(LogFormatter):
    """Plain numbers at the ticks that matplotlib labels."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        """Return a label; see `LogFormatter`."""
        return f"{x:g}" if super().__call__(x, pos) else ""


def _widen_axis(axes: Axes) -> None:
    """Widen an axis, so that a few per cent stay small, with plain numbers beside it."""
    low, high = axes.dataLim.intervaly
    more = max(1.15, math.sqrt(MIN_SPAN * low / high))
    axes.set_autoscaley_on(False)
    axes.set_ylim(low / more, high * more)
    for axis in ("major", "minor"):
        getattr(axes.yaxis, f"set_{axis}_formatter")(PlainFormatter())


def _plot_panel(axes: Axes, plot_line: PlotLine, quantity: str, label: str, color: str) -> None:
    fit = plot_line.time if quantity == "time" else plot_line.memory
    x, y = (plot_line.size, plot_line.seconds) if quantity == "time" else plot_line.reported_bytes
    if not x:
        return
    scale = 1e3 if quantity == "time" else 1e-9
    if fit is not None:
        label += f": {format_exponent(fit)}, {fit.last:.2f}"
    values = [scale * each for each in y]
    axes.plot(x, values, marker="o", markersize=4.5, linestyle="", color=color, label=label)
    if quantity == "time":
        low, high = ([scale * each for each in end] for end in (plot_line.low, plot_line.high))
        axes.vlines(x, low, high, color=color, linewidth=1.2)
    linear: LinearFit | None = fit_linear(x, y)
    if linear is not None:
        along = np.geomspace(x[0], x[-1], 60)
        axes.plot(along, scale * (linear.fixed + linear.each * along), color=color, linewidth=1.0)


def _plot_published(axes: Axes) -> None:
    axes.plot(
        PUBLISHED_WORLDS,
        [1e3 * n * STEPS / rate for n, rate in zip(PUBLISHED_WORLDS, PUBLISHED_RATES, strict=True)],
        marker="x",
        markersize=4.5,
        linewidth=0.8,
        color=style.QUIET,
        label="crazyflow, RTX 4090, published",
    )


def main(
    rows: Annotated[Path, tyro.conf.Positional],
    figures: Path | None = None,
    page: Path | None = None,
) -> None:
    """Print the fits; plot them, and write them into a page.

    Args:
        rows: File of rows, by angler_experiments.scalability.cost.
        figures: Folder of scalability_time.png and scalability_memory.png; the fits are written
            beside the rows.
        page: Document with marks between which the table is replaced.
    """
    plot_lines = read_lines(rows)
    print(format_fits(plot_lines))
    figure_paths = []
    if figures is not None:
        for quantity in ("time", "memory"):
            picture = figures / f"scalability_{quantity}.png"
            figure_paths.append(
                style.save_figure(plot_costs(plot_lines, quantity), picture, palette=64)
            )
        fits = [
            {
                "ladder": item.ladder,
                "engine": item.engine,
                "device": item.device,
                "size": item.size,
                "seconds": item.seconds,
                "bytes": item.bytes,
                "time": _to_json(item.time),
                "memory": _to_json(item.memory),
                "shares": _to_json(fit_linear(item.size, item.seconds)),
            }
            for item in plot_lines
        ]
        rows.with_suffix(".fits.json").write_text(json.dumps(fits, indent=1) + "\n")
    if page is not None:
        pictures = [markdown_tables.image_link(page, item) for item in figure_paths]
        markdown_tables.replace_section(
            page, BEGIN, "\n\n".join([*pictures, format_fits(plot_lines)]), END
        )


def _to_json(fit: PowerLawFit | LinearFit | None) -> dict[str, float | None] | None:
    """Return a fit as a table, null for NaN."""
    if fit is None:
        return None
    return {key: None if math.isnan(value) else value for key, value in vars(fit).items()}


if __name__ == "__main__":
    tyro.cli(main)
