"""Figures of a study: success and time by size of the team, a colour for each condition."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullFormatter, ScalarFormatter

from angler_mjx.report.viewing import style
from angler_mjx.studies.fleet_size.report import level

SUCCESS, TIME = "success.png", "time.png"


def draw(found: Mapping[str, Any], place: Path) -> list[Path]:
    """Both figures of a study, into a folder."""
    with style.styled():
        return [
            style.save(success(found), place / SUCCESS, palette=128),
            style.save(time(found), place / TIME, palette=128),
        ]


def success(found: Mapping[str, Any]) -> Figure:
    """Share of worlds that met the deadline, and the answers below."""
    conditions = found["conditions"]
    bars_in = 0.5 + 0.24 * len(conditions)
    figure = style.new_figure(8.0, 4.4 + bars_in, headline_in=0.75)
    style.headline(
        figure,
        f"{found['name']}: how many robots does it take?",
        f"done within {found['deadline_s']:g} s; {found['worlds']:,} worlds; bars are "
        f"{level(found, 'share')} intervals of a share, lines below {level(found, 'answer')} "
        "intervals of the answer",
    )
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=[3.6, bars_in])
    p = found["probability"]
    above.axhline(p, color=style.INK, linewidth=1.0, linestyle=(0, (4, 3)))
    above.annotate(
        f"{100 * p:g} %",
        (1.0, p),
        xycoords=("axes fraction", "data"),
        xytext=(4, 0),
        textcoords="offset points",
        va="center",
        color=style.INK,
    )
    for i, one in enumerate(conditions):
        rows, color = one["sizes"], style.robot_color(i)
        if not rows:
            continue
        x = _aside([row["size"] for row in rows], i, len(conditions))
        y = np.array([row["rate"] for row in rows])
        ends = np.array([[row["rate"] - row["low"], row["high"] - row["rate"]] for row in rows]).T
        above.plot(x, y, color=color, linewidth=1.3, alpha=0.7)
        above.errorbar(
            x,
            y,
            np.maximum(ends, 0.0),
            fmt="o",
            color=color,
            markersize=3.8,
            capsize=2.0,
            linewidth=1.1,
            label=one["name"],
        )
    above.set_ylim(-0.03, 1.03)
    above.set_ylabel("worlds that met the deadline")
    above.yaxis.set_major_formatter(lambda value, _: f"{100 * value:.0f} %")
    above.grid(axis="y")
    above.legend(loc="lower right" if len(conditions) < 6 else "best")
    _answers(below, found)
    _sizes(below, found)
    below.set_xlabel("robots")
    return figure


def _answers(axes: Axes, found: Mapping[str, Any]) -> None:
    """The interval of each condition's answer."""
    conditions, top = found["conditions"], found["sizes"][-1]
    for i, one in enumerate(conditions):
        known, color = one["answer"], style.robot_color(i)
        low, high = known["low"], known["high"]
        if low is not None:
            ends = [low, top if high is None else high]
            axes.plot(ends, [i, i], color=color, linewidth=4.0, solid_capstyle="round", alpha=0.45)
            if known["estimate"] is not None:
                axes.plot([known["estimate"]], [i], "o", color=color, markersize=5.5)
        if low is None or high is None:
            axes.plot([top], [i], ">", color=color, markersize=6.0)
        axes.annotate(
            known["text"],
            (top if low is None or high is None else high, i),
            xytext=(8, 0) if (low or top) <= top / 4 else (-8, 8),
            textcoords="offset points",
            ha="left" if (low or top) <= top / 4 else "right",
            va="center",
            fontsize=7.5,
            color=style.QUIET,
        )
    axes.set_yticks(range(len(conditions)), [one["name"] for one in conditions])
    axes.set_ylim(len(conditions) - 0.4, -0.6)
    axes.tick_params(axis="y", length=0)
    axes.grid(axis="x")


def time(found: Mapping[str, Any]) -> Figure:
    """Median and 90 % quantile of the time that the task takes."""
    conditions = found["conditions"]
    figure = style.new_figure(8.0, 4.4, headline_in=0.75)
    style.headline(
        figure,
        f"{found['name']}: how long does it take?",
        f"median over all worlds, with its {level(found, 'quantile')} interval; dots: nine "
        "worlds in ten are done by then",
    )
    axes = figure.subplots()
    axes.axhline(found["deadline_s"], color=style.INK, linewidth=1.0, linestyle=(0, (4, 3)))
    axes.annotate(
        "deadline",
        (1.0, found["deadline_s"]),
        xycoords=("axes fraction", "data"),
        xytext=(-2, 3),
        textcoords="offset points",
        ha="right",
        va="bottom",
        color=style.INK,
    )
    horizon_s = max((row["horizon_s"] for one in conditions for row in one["sizes"]), default=1.0)
    for i, one in enumerate(conditions):
        color = style.robot_color(i)
        rows = [row for row in one["sizes"] if row["median_s"]["value"] is not None]
        x = _aside([row["size"] for row in rows], i, len(conditions))
        y = np.array([row["median_s"]["value"] for row in rows])
        low = np.array([row["median_s"]["low"] for row in rows])
        high = np.array([row["median_s"]["high"] or horizon_s for row in rows])
        axes.errorbar(
            x,
            y,
            [y - low, high - y],
            fmt="-o",
            color=color,
            markersize=3.8,
            capsize=2.0,
            linewidth=1.2,
            label=one["name"],
        )
        late = [(a, row["p90_s"]["value"]) for a, row in zip(x, rows, strict=True)]
        late = [pair for pair in late if pair[1] is not None]
        axes.plot(*np.array(late).reshape(-1, 2).T, ":", marker=".", color=color, linewidth=1.0)
    axes.set_ylim(0.0, horizon_s * 1.02)
    axes.set_ylabel("time until the task is done, s")
    axes.set_xlabel("robots")
    axes.grid(axis="y")
    axes.legend(loc="best")
    _sizes(axes, found)
    return figure


def _sizes(axes: Axes, found: Mapping[str, Any]) -> None:
    """Sizes along x, by their logarithm."""
    sizes = found["sizes"]
    flown = {row["size"] for one in found["conditions"] for row in one["sizes"]}
    shown = sorted({size for size in flown if size & (size - 1) == 0} | {sizes[0], sizes[-1]})
    axes.set_xscale("log", base=2)
    axes.set_xlim(sizes[0] / 1.25, sizes[-1] * 1.25)
    axes.xaxis.set_major_locator(FixedLocator(shown))
    axes.xaxis.set_minor_locator(FixedLocator(sorted(flown)))
    axes.xaxis.set_major_formatter(ScalarFormatter())
    axes.xaxis.set_minor_formatter(NullFormatter())


def _aside(sizes: Sequence[int], i: int, of: int) -> np.ndarray:
    """Sizes moved a little, so that bars of conditions stand side by side."""
    moved: np.ndarray = np.array(sizes, float) * 1.02 ** (i - 0.5 * (of - 1))
    return moved
