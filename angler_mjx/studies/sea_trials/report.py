"""Table and figure of the sea trials of a vehicle."""

import csv
import math
import textwrap
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from angler_mjx.report.plotting import style
from angler_mjx.runs.storage.atomic_files import wrap_write_errors, write_atomically
from angler_mjx.studies.sea_trials.check_vehicle import VehicleCheck
from angler_mjx.studies.sea_trials.measures import Measure

TABLE, FIGURE = "table.csv", "figure.png"
_COLUMNS = ("trial", "quantity", "value", "unit", "note")
_WINDOW = 1.1
"""Times of a zig-zag's third reversal that are shown."""


def format_value(measure: Measure) -> str:
    """Return a value with its unit; a dash where the vehicle does not come so far."""
    if not math.isfinite(measure.value):
        return "-"
    return f"{measure.value:.4g} {measure.unit}".rstrip()


def list_rows(check: VehicleCheck) -> Iterator[tuple[str, str, str, str]]:
    """Yield trial, quantity, value and note of each measure, and of what was left out."""
    for measure in check.measures:
        yield measure.trial, measure.quantity, format_value(measure), measure.note
    for trial, reason in check.left_out.items():
        yield trial, "", "not done", reason


def write_table(check: VehicleCheck, path: Path) -> None:
    """Write all measures as CSV; values are empty where there are none.

    Raises:
        RunError: the file cannot be written.
    """
    with (
        wrap_write_errors(path),
        write_atomically(path) as writing,
        writing.open("w", encoding="utf-8", newline="") as file,
    ):
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(_COLUMNS)
        for measure in check.measures:
            value = f"{measure.value:.6g}" if math.isfinite(measure.value) else ""
            writer.writerow([measure.trial, measure.quantity, value, measure.unit, measure.note])
        for trial, reason in check.left_out.items():
            writer.writerow([trial, "", "", "", reason])


def plot_check(check: VehicleCheck) -> Figure:
    """Plot turning circles, zig-zags, the spiral, stops, and decays; panels of what was done."""
    held = ", roll and pitch held" if check.level else ""
    subtitle = f"parameter set {check.parameter_set}, open-loop commands, still water{held}"
    with style.titled_figure(10.0, 6.4, f"Sea trials of {check.vehicle}", subtitle) as figure:
        panels = figure.subplots(2, 3).ravel()
        for axes, (plot, word) in zip(
            panels,
            (
                (_plot_turns, "circle"),
                (_plot_zigzags, "zig-zag"),
                (_plot_spiral, "spiral"),
                (_plot_stops, "stop"),
                (_plot_speeds, "surge"),
                (_plot_decays, "decay"),
            ),
            strict=True,
        ):
            plot(axes, check)
            if not axes.lines:
                axes.text(
                    0.5, 0.5, _find_reason(check, word), ha="center", va="center", color=style.QUIET
                )
                axes.set_axis_off()
            elif axes.get_legend_handles_labels()[0]:
                axes.legend(fontsize="x-small")
    return figure


def _find_reason(check: VehicleCheck, word: str) -> str:
    """Return the text of an empty panel: why trials with a word in their name were not done."""
    reasons = [reason for trial, reason in check.left_out.items() if word in trial]
    return "\n".join(["not done", *(textwrap.wrap(reasons[0], 40) if reasons else [])])


def _plot_turns(axes: Axes, check: VehicleCheck) -> None:
    axes.set(title="turning circle", xlabel="x, m", ylabel="y, m")
    for i, side in enumerate(("port", "starboard")):
        name = f"turning circle to {side}"
        if name in check.motions:
            motion, begin = check.motions[name], check.execute_index
            p = motion.p[begin:, :2] - motion.p[begin, :2]
            axes.plot(p[:, 0], p[:, 1], color=style.robot_color(i), label=side)
            axes.set_aspect("equal", adjustable="datalim")


def _plot_zigzags(axes: Axes, check: VehicleCheck) -> None:
    axes.set(title="zig-zag", xlabel="time, s", ylabel="heading, deg")
    names = [name for name in check.motions if name.startswith("zig-zag")]
    for i, name in enumerate(names):
        motion, begin = check.motions[name], check.execute_index
        heading = np.degrees(motion.yaw_rad[begin:] - motion.yaw_rad[begin])
        flips = np.flatnonzero(np.diff(motion.steering[begin:]))
        end = int(_WINDOW * flips[3]) if len(flips) > 3 else len(heading)
        axes.plot(
            motion.time_s[: len(heading)][:end],
            heading[:end],
            color=style.robot_color(i),
            label=name.removeprefix("zig-zag "),
        )


def _plot_spiral(axes: Axes, check: VehicleCheck) -> None:
    axes.set(title="spiral", xlabel="steering, fraction", ylabel="yaw rate, deg/s")
    if check.spiral.size:
        for column, side in ((1, "port"), (2, "starboard")):
            axes.plot(
                check.spiral[:, 0],
                check.spiral[:, column],
                marker="o",
                markersize=3,
                color=style.robot_color(column - 1),
                label=f"from {side}",
            )


def _plot_stops(axes: Axes, check: VehicleCheck) -> None:
    axes.set(title="stop", xlabel="time, s", ylabel="surge, m/s")
    for i, name in enumerate(("coasting stop", "crash stop")):
        if name in check.motions:
            motion, begin = check.motions[name], check.execute_index
            surge = motion.nu[begin:, 0]
            end = len(surge)
            if name == "crash stop" and np.any(surge < 0):
                end = int(np.argmax(surge < 0)) + 1
            axes.plot(motion.time_s[:end], surge[:end], color=style.robot_color(i), label=name)


def _plot_speeds(axes: Axes, check: VehicleCheck) -> None:
    axes.set(title="full push from rest", xlabel="time, s", ylabel="speed, m/s")
    columns = {"surge ahead": 0, "surge astern": 0, "sway to port": 1, "heave up": 2}
    columns["heave down"] = 2
    for i, (name, column) in enumerate(columns.items()):
        if name in check.motions:
            motion, end = check.motions[name], check.execute_index // 2
            axes.plot(
                motion.time_s[:end],
                np.abs(motion.nu[:end, column]),
                color=style.robot_color(i),
                label=name,
            )


def _plot_decays(axes: Axes, check: VehicleCheck) -> None:
    axes.set(title="free decay", xlabel="time, s", ylabel="angle, deg")
    for i, axis in enumerate(("roll", "pitch")):
        if f"{axis} decay" in check.motions:
            motion = check.motions[f"{axis} decay"]
            end = len(motion.time_s) // 2
            angle = np.degrees(getattr(motion, f"{axis}_rad"))[:end]
            axes.plot(motion.time_s[:end], angle, color=style.robot_color(i), label=axis)
