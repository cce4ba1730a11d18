"""Cost of communication by modem for a fleet, in one figure of a fleet-size study.

    python -m angler_experiments.acoustics.fleets docs/fleet_size/survey_reef.json

The study must hold two conditions that differ in communication alone. Its file has every number.
"""

import json
from pathlib import Path
from typing import Annotated, Literal, TypedDict

import tyro

from angler_mjx.errors import ConfigError
from angler_mjx.report.plotting import style

MEASURES: tuple[tuple[Literal["rate", "median_s", "lost_per_robot"], str, float], ...] = (
    ("rate", "met the deadline, %", 100.0),
    ("median_s", "median time until it is done, s", 1.0),
    ("lost_per_robot", "robots lost, %", 100.0),
)
"""Key of a size in a study's file, label of its axis, and the factor between the two."""


class Estimated(TypedDict):
    """Number with an interval; None where it is never reached."""

    value: float | None


type Measure = Estimated | float | None


class TeamResults(TypedDict):
    """Results of one size of a team."""

    size: int
    rate: Measure
    median_s: Measure
    lost_per_robot: Measure


def read_conditions(study: Path, names: tuple[str, str]) -> list[list[TeamResults]]:
    """Return the flown sizes, smallest first, of two conditions of a study.

    Raises:
        ConfigError: the file is not one of a study, or lacks the condition.
    """
    try:
        sizes_by_condition = {
            condition["name"]: condition["sizes"]
            for condition in json.loads(study.read_text())["conditions"]
        }
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ConfigError(
            f"{study}: is no study.json of angler study fleet_size: {error}"
        ) from None
    for name in names:
        if name not in sizes_by_condition:
            raise ConfigError(
                f"{study}: no condition {name!r}; it has {', '.join(map(repr, sizes_by_condition))}"
            )
    return [sorted(sizes_by_condition[name], key=lambda size: size["size"]) for name in names]


def plot_conditions(
    conditions_sizes: list[list[TeamResults]], labels: tuple[str, str], out: Path
) -> None:
    """Plot success, time and losses against the size of the team, of both conditions."""
    ticks = [1 << k for k in range(7)]
    with style.figure_style():
        chart = style.new_figure(11.0, 3.4)
        for panel, (key, text, factor) in zip(chart.subplots(1, 3), MEASURES, strict=True):
            for i, (sizes, label) in enumerate(zip(conditions_sizes, labels, strict=True)):
                points = [
                    (size_entry["size"], _scale_value(size_entry[key], factor))
                    for size_entry in sizes
                ]
                finite_points = [(size, value) for size, value in points if value is not None]
                panel.plot(
                    *zip(*finite_points, strict=True), "o-", color=style.robot_color(i), label=label
                )
            panel.set(
                xlabel="robots", ylabel=text, xscale="log", xlim=(0.9, 72.0), ylim=(0.0, None)
            )
            panel.set_xticks(ticks, [str(tick) for tick in ticks])
            panel.minorticks_off()
        chart.axes[0].legend(fontsize=8, loc="lower right")
        style.save_figure(chart, out, palette=64)


def _scale_value(value: Measure, factor: float) -> float | None:
    """Scale a number of a study, with an interval or without; None where it is never reached."""
    middle = value["value"] if isinstance(value, dict) else value
    return None if middle is None else factor * float(middle)


def main(
    study: Annotated[Path, tyro.conf.Positional],
    out: Path = Path("docs/images/acoustic_fleets.png"),
    perfect: str = "still water",
    acoustic: str = "acoustic",
) -> None:
    """Plot the figure.

    Args:
        study: Its study.json.
        out: Picture to write.
        perfect: Condition with complete information on other robots.
        acoustic: The same with modems.
    """
    try:
        plot_conditions(
            read_conditions(study, (perfect, acoustic)), ("all know all", "by modem, in turn"), out
        )
    except ConfigError as error:
        raise SystemExit(f"error: {error}") from None
    print(out)


if __name__ == "__main__":
    tyro.cli(main)
