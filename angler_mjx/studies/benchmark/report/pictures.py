"""Maps from above: where robots failed, and examples of what was planned and flown."""

from typing import Any

import matplotlib.patheffects as effects
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch

from angler_mjx.report.viewing import style
from angler_mjx.studies.benchmark.report import look
from angler_mjx.studies.benchmark.report.reading import Results
from angler_mjx.studies.benchmark.report.scenes import Example, ScenePath

_HALO = [effects.withStroke(linewidth=2.4, foreground=style.PAPER)]
_MANY = 400
_PLANNED: dict[str, Any] = {"linewidth": 0.9, "linestyle": "--"}
_FLOWN: dict[str, Any] = {"linewidth": 1.5}
_GOAL: dict[str, Any] = {"marker": "*", "markersize": 9, "linestyle": ""}
_FAILURE: dict[str, Any] = {"marker": "X", "markersize": 7, "linestyle": "", "color": style.INK}
"""Of the lines and marks of an example, on its maps and in its legend."""


def failures(results: Results) -> Figure | None:
    """Where robots failed, from above, by outcome; a panel a scene."""
    held = results.failures
    scene_of = dict(zip(results.runs["run"].tolist(), results.runs["scene"], strict=True))
    scene = np.array([scene_of.get(run) for run in held.run.tolist()], object)
    shown = [name for name in results.scenes if np.any(scene == name)]
    if not shown:
        return None
    outcomes = sorted(set(held.outcome.tolist()))
    across = min(len(shown), 3)
    down = -(-len(shown) // across)
    with look.styled():
        figure = style.new_figure(max(4.2 * across, 7.0), 4.1 * down + 1.2, headline_in=0.65)
        style.headline(
            figure,
            f"{results.about.get('name', '')}: where robots failed",
            "centres of robots that had a path when they failed, from above, of all planners",
        )
        for axes, name in zip(
            look.panels(figure, len(shown), across, sharey=False), shown, strict=True
        ):
            here = scene == name
            axes.set_title(f"{name}: {int(here.sum()):,}")
            axes.set(xlabel="east, m", ylabel="north, m", facecolor=style.WATER)
            axes.set_aspect("equal", adjustable="datalim")
            for outcome in outcomes:
                of = here & (held.outcome == outcome)
                axes.plot(
                    held.x_m[of],
                    held.y_m[of],
                    "o",
                    color=style.OUTCOMES.get(outcome, style.QUIET),
                    markersize=2.6 if here.sum() > _MANY else 4.0,
                    alpha=0.6,
                    markeredgewidth=0,
                )
        figure.legend(
            handles=[
                Line2D(
                    [],
                    [],
                    color=style.OUTCOMES.get(outcome, style.QUIET),
                    marker="o",
                    linestyle="",
                    label=style.OUTCOME_TEXT.get(outcome, outcome.replace("_", " ")),
                )
                for outcome in outcomes
            ],
            loc="outside lower left",
            ncols=min(len(outcomes), 4),
        )
    return figure


def example(given: Example) -> Figure | None:
    """What each planner made of one problem, a panel each; None without a planner."""
    if not given.ways:
        return None
    across = min(len(given.ways), 4)
    down = -(-len(given.ways) // across)
    with look.styled():
        figure = style.new_figure(max(3.1 * across, 7.5), 3.7 * down + 1.1, headline_in=0.65)
        style.headline(figure, given.title, "from above; a colour a robot; lighter rock is higher")
        for axes, way in zip(look.panels(figure, len(given.ways), across), given.ways, strict=True):
            axes.set_title(way.planner, fontsize=10.5)
            axes.set_xlabel(_how(way), fontsize=8.5)
            axes.set_aspect("equal")
            _ground(axes, given)
            for robot in range(len(given.start_m)):
                _robot(axes, given, way, robot)
        figure.legend(handles=_signs(given), loc="outside lower left", ncols=4)
    return figure


def _how(way: ScenePath) -> str:
    planned = int(np.sum(np.isfinite(way.planned_m).all(axis=2).any(axis=1)))
    if not len(way.flown_m):
        return f"not flown; {planned} of {len(way.planned_m)} robots have a path"
    return f"{way.outcome.count('reached')} of {len(way.outcome)} robots arrived"


def _ground(axes: Axes, given: Example) -> None:
    nx, ny, nz = given.occupied.shape
    (x, y), cell = given.origin_m[:2], given.cell_m
    axes.set_facecolor(style.WATER)
    top = given.top
    axes.imshow(
        np.ma.masked_equal(top / nz, 0.0).T,
        origin="lower",
        extent=(x, x + nx * cell, y, y + ny * cell),
        cmap=style.ROCK,
        vmin=0,
        vmax=1,
        zorder=1,
    )
    for p, radius, moves in zip(
        given.obstacle_p_m, given.obstacle_radius_m, given.obstacle_moves, strict=True
    ):
        color = style.OBSTACLE_DYNAMIC if moves else style.OBSTACLE_STATIC
        axes.add_patch(
            Circle((float(p[0]), float(p[1])), float(radius), color=color, alpha=0.6, zorder=2)
        )


def _robot(axes: Axes, given: Example, way: ScenePath, robot: int) -> None:
    color = style.robot_color(robot)
    planned = way.planned_m[robot]
    axes.plot(planned[:, 0], planned[:, 1], color=color, zorder=4, **_PLANNED)
    start, goal = given.start_m[robot], given.goal_m[robot]
    axes.plot(*start[:2], "o", color=color, ms=5, mec=style.PAPER, mew=0.6, zorder=6)
    axes.plot(*goal[:2], color=color, mec=style.PAPER, mew=0.6, zorder=6, **_GOAL)
    if not len(way.flown_m):
        return
    flown = way.flown_m[:, robot]
    axes.plot(flown[:, 0], flown[:, 1], color=color, zorder=5, path_effects=_HALO, **_FLOWN)
    known = flown[np.isfinite(flown).all(axis=1)]
    if way.outcome[robot] != "reached" and len(known):
        axes.plot(*known[-1, :2], mec=style.PAPER, zorder=7, **_FAILURE)


def _signs(given: Example) -> list[Line2D | Patch]:
    quiet = style.QUIET
    signs: list[Line2D | Patch] = [
        Line2D([], [], color=quiet, label="planned", **_PLANNED),
        Line2D([], [], color=quiet, label="flown", **_FLOWN),
        Line2D([], [], color=quiet, label="goal (disc: start)", **_GOAL),
        Line2D([], [], label="failure", **_FAILURE),
    ]
    if given.obstacle_moves.any():
        signs.append(
            Patch(color=style.OBSTACLE_DYNAMIC, alpha=0.6, label="moving obstacle, at the start")
        )
    if (~given.obstacle_moves).any():
        signs.append(Patch(color=style.OBSTACLE_STATIC, alpha=0.6, label="still obstacle"))
    return signs
