"""Figures and tables of what more costs, from a file of rows; nothing is computed anew.

The page says the command, docs/scalability.md.
"""

import json
import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter

from angler_experiments.scalability.cost import PREFIX
from angler_experiments.scalability.fits import Fit, Shares, power, shares
from angler_experiments.scalability.ladders import BY_NAME, LADDERS
from angler_mjx.errors import ConfigError
from angler_mjx.report.viewing import style, tables
from angler_mjx.studies.speed import rows as speed

BEGIN, END = "<!-- cost: begin -->", "<!-- cost: end -->"
"""What stands between them in a page is replaced by the tables."""
STEPS = 100
"""Physics steps whose time is told: a second of simulated time of ours."""
LEAST_SPAN = 5.0
"""Of an axis of costs, from its end to its beginning."""
PUBLISHED = {
    "source": "Crazyflow 0.4.0, table in its README: RTX 4090, first-principles dynamics, one "
    "drone in each world",
    "worlds": (64, 1024, 16_384, 65_536, 262_144),
    "rate": (1.2e6, 18.7e6, 257e6, 678e6, 914e6),
}
"""Beside ours as they were published: other machines, another vehicle."""


@dataclass(frozen=True, kw_only=True)
class PlotLine:
    """What one engine on one device took over one ladder."""

    ladder: str
    engine: str
    device: str
    size: tuple[float, ...]
    seconds: tuple[float, ...]
    """For ``STEPS`` physics steps of all robots, medians."""
    low: tuple[float, ...]
    high: tuple[float, ...]
    bytes: tuple[float | None, ...]
    """Of the program: arguments, results and temporaries; None where XLA does not say."""

    @property
    def time(self) -> Fit | None:
        """Of the seconds."""
        return power(self.size, self.seconds)

    @property
    def memory(self) -> Fit | None:
        """Of the bytes."""
        return power(*self.known_bytes)

    @property
    def known_bytes(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Sizes and bytes where XLA says how many."""
        known = [(x, y) for x, y in zip(self.size, self.bytes, strict=True) if y]
        return tuple(x for x, _ in known), tuple(y for _, y in known)


def lines(path: Path) -> list[PlotLine]:
    """All lines of a file of rows; of several rows of one size the last counts.

    Raises:
        ConfigError: the file cannot be read, or holds no such row.
    """
    held: dict[tuple[str, str, str], dict[float, dict[str, Any]]] = defaultdict(dict)
    for row in speed.read(path):
        if row["workload"].startswith(PREFIX) and row["median"] is not None:
            name = row["workload"].removeprefix(PREFIX)
            key = (name, row["engine"], str(row["device"]))
            held[key][row["extra"]["size"]] = row
    if not held:
        raise ConfigError(f"{path}: holds no row of {PREFIX}*")
    order = {name: i for i, name in enumerate(BY_NAME)}
    return [
        _line(*key, found)
        for key, found in sorted(held.items(), key=lambda one: (order[one[0][0]], *one[0][1:]))
    ]


def _line(ladder: str, engine: str, device: str, found: dict[float, dict[str, Any]]) -> PlotLine:
    size = tuple(sorted(found))
    each = [found[x] for x in size]
    work = [row["worlds"] * row["robots"] * STEPS for row in each]

    def seconds(key: str) -> tuple[float, ...]:
        return tuple(steps / row[key] for steps, row in zip(work, each, strict=True))

    return PlotLine(
        ladder=ladder,
        engine=engine,
        device=device,
        size=size,
        seconds=seconds("median"),
        low=seconds("high"),
        high=seconds("low"),
        bytes=tuple(row["program_bytes"] for row in each),
    )


def table(found: Sequence[PlotLine]) -> str:
    """The fits, in Markdown."""
    several = _several_devices(found)
    head = ["what is varied", "engine", *["device"] * several, "from", "to", f"ms, {STEPS} steps"]
    head += ["exponent of time (95 %)", "of the last step", "fixed, ms", "each more, us"]
    head += ["memory, to", "its exponent (95 %)"]
    body = []
    for one in found:
        time, parts = one.time, shares(one.size, one.seconds)
        most = next((x for x in reversed(one.bytes) if x), None)
        body.append(
            [
                BY_NAME[one.ladder].label,
                one.engine,
                *[one.device] * several,
                f"{one.size[0]:,.0f}",
                f"{one.size[-1]:,.0f}",
                f"{1e3 * one.seconds[0]:.3g} to {1e3 * one.seconds[-1]:.3g}",
                exponent(time),
                "-" if time is None else f"{time.last:.2f}",
                "-" if parts is None else f"{1e3 * parts.fixed:.3g}",
                "-" if parts is None else f"{1e6 * parts.each:.3g}",
                "-" if most is None else amount(most),
                exponent(one.memory),
            ]
        )
    return tables.table(head, body)


def _several_devices(found: Sequence[PlotLine]) -> bool:
    return len({one.device for one in found}) > 1


def exponent(fit: Fit | None) -> str:
    """An exponent with its interval."""
    if fit is None:
        return "-"
    if math.isnan(fit.low):
        return f"{fit.exponent:.2f}"
    return f"{fit.exponent:.2f} ({fit.low:.2f} to {fit.high:.2f})"


def amount(n_byte: float) -> str:
    """Bytes, in GB or MB."""
    return f"{n_byte / 1e9:.3g} GB" if n_byte >= 1e9 else f"{n_byte / 1e6:.3g} MB"


def draw(found: Sequence[PlotLine], what: str) -> Figure:
    """Costs on logarithmic axes, a panel for each thing that is varied.

    Args:
        found: lines.
        what: time or memory.
    """
    shown = [one for one in LADDERS if any(x.ladder == one.name for x in found)]
    columns = min(3, len(shown))
    down = -(-len(shown) // columns)
    kinds = sorted({(one.engine, one.device) for one in found})
    colors = {kind: style.robot_color(i) for i, kind in enumerate(kinds)}
    where = "" if _several_devices(found) else f"{found[0].device}; "
    words = {
        "time": ("What more costs in time", f"{where}ms for {STEPS} physics steps of all robots"),
        "memory": ("What more costs in memory", f"{where}GB of the program, by XLA's account"),
    }[what]
    with style.styled():
        figure = style.new_figure(11.4, 0.9 + 3.5 * down, headline_in=0.65)
        told = (
            "Lines: a fixed cost and one of each; numbers: exponents (95 %), and of the last step"
        )
        style.headline(figure, words[0], f"{words[1]}. {told}")
        every = list(figure.subplots(down, columns, squeeze=False).flat)
        for axes, ladder in zip(every, shown, strict=False):
            axes.set_title(ladder.label, fontsize=10)
            axes.set_xscale("log", base=2)
            axes.set_yscale("log")
            for one in found:
                if one.ladder == ladder.name:
                    label = f"{one.engine}, {one.device}" if where == "" else one.engine
                    _panel(axes, one, what, label, colors[one.engine, one.device])
            if ladder.name == "dynamics" and what == "time":
                _published(axes)
            _widen(axes)
            axes.grid(True)
            axes.legend(
                fontsize=7.5, loc="upper left", bbox_to_anchor=(0.0, -0.1), borderaxespad=0.0
            )
        for axes in every[len(shown) :]:
            axes.set_axis_off()
    return figure


class Plain(LogFormatter):
    """Plain numbers at the ticks that matplotlib thinks should have one."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        """See `LogFormatter`."""
        return f"{x:g}" if super().__call__(x, pos) else ""


def _widen(axes: Axes) -> None:
    """So that a few per cent do not look like much; plain numbers beside it."""
    low, high = axes.dataLim.intervaly
    more = max(1.15, math.sqrt(LEAST_SPAN * low / high))
    axes.set_autoscaley_on(False)
    axes.set_ylim(low / more, high * more)
    for axis in ("major", "minor"):
        getattr(axes.yaxis, f"set_{axis}_formatter")(Plain())


def _panel(axes: Axes, one: PlotLine, what: str, label: str, color: str) -> None:
    fit = one.time if what == "time" else one.memory
    x, y = (one.size, one.seconds) if what == "time" else one.known_bytes
    if not x:
        return
    scale = 1e3 if what == "time" else 1e-9
    if fit is not None:
        label += f": {exponent(fit)}, {fit.last:.2f}"
    shown = [scale * each for each in y]
    axes.plot(x, shown, marker="o", markersize=4.5, linestyle="", color=color, label=label)
    if what == "time":
        low, high = ([scale * each for each in end] for end in (one.low, one.high))
        axes.vlines(x, low, high, color=color, linewidth=1.2)
    parts: Shares | None = shares(x, y)
    if parts is not None:
        along = np.geomspace(x[0], x[-1], 60)
        axes.plot(along, scale * (parts.fixed + parts.each * along), color=color, linewidth=1.0)


def _published(axes: Axes) -> None:
    worlds: Any = PUBLISHED["worlds"]
    rate: Any = PUBLISHED["rate"]
    axes.plot(
        worlds,
        [1e3 * n * STEPS / each for n, each in zip(worlds, rate, strict=True)],
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
    """Print the fits; draw them, and put them into a page.

    Args:
        rows: File of rows, by angler_experiments.scalability.cost.
        figures: Folder to draw scalability_time.png and scalability_memory.png into, and to write
            the fits beside the rows.
        page: Document that has the marks between which the table is put.
    """
    found = lines(rows)
    print(table(found))
    drawn = []
    if figures is not None:
        for what in ("time", "memory"):
            picture = figures / f"scalability_{what}.png"
            drawn.append(style.save(draw(found, what), picture, palette=64))
        fits = [
            {
                "ladder": one.ladder,
                "engine": one.engine,
                "device": one.device,
                "size": one.size,
                "seconds": one.seconds,
                "bytes": one.bytes,
                "time": _plain(one.time),
                "memory": _plain(one.memory),
                "shares": _plain(shares(one.size, one.seconds)),
            }
            for one in found
        ]
        rows.with_suffix(".fits.json").write_text(json.dumps(fits, indent=1) + "\n")
    if page is not None:
        pictures = [tables.picture(page, one) for one in drawn]
        tables.put(page, BEGIN, "\n\n".join([*pictures, table(found)]), END)


def _plain(fit: Fit | Shares | None) -> dict[str, float | None] | None:
    """A fit as a table, null for NaN."""
    if fit is None:
        return None
    return {key: None if math.isnan(value) else value for key, value in vars(fit).items()}


if __name__ == "__main__":
    tyro.cli(main)
