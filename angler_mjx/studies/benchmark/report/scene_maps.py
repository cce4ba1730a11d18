"""Maps from above: where robots failed, and examples of what was planned and flown."""

from typing import Literal, TypedDict

import matplotlib.patheffects as effects
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch

from angler_mjx.report.plotting import series, style
from angler_mjx.studies.benchmark.report.reading import Results
from angler_mjx.studies.benchmark.report.scenes import Example, ScenePath

_HALO = [effects.withStroke(linewidth=2.4, foreground=style.PAPER)]
_MANY_FAILURES = 400


class _Look(TypedDict, total=False):
    """How a line or mark of an example looks, on its maps and in its legend."""

    linewidth: float
    linestyle: Literal["--", ""]
    marker: str
    markersize: float


_PLANNED: _Look = {"linewidth": 0.9, "linestyle": "--"}
_FLOWN: _Look = {"linewidth": 1.5}
_GOAL: _Look = {"marker": "*", "markersize": 9, "linestyle": ""}
_FAILURE: _Look = {"marker": "X", "markersize": 7, "linestyle": ""}


def plot_failures(results: Results) -> Figure | None:
    """Where robots failed, from above, by outcome; a panel a scene."""
    all_failures = results.failures
    scene_of = dict(zip(results.runs["run"].tolist(), results.runs["scene"], strict=True))
    scene = np.array([scene_of.get(run) for run in all_failures.run.tolist()], object)
    shown = [name for name in results.scenes if np.any(scene == name)]
    if not shown:
        return None
    outcomes = sorted(set(all_failures.outcome.tolist()))
    n_columns = min(len(shown), 3)
    n_rows = -(-len(shown) // n_columns)
    with style.titled_figure(
        max(4.2 * n_columns, 7.0),
        4.1 * n_rows + 1.2,
        f"{results.about.get('name', '')}: where robots failed",
        "centres of robots that had a path when they failed, from above, of all planners",
        parse_math=False,
    ) as figure:
        for axes, name in zip(
            series.add_panels(figure, len(shown), n_columns, sharey=False), shown, strict=True
        ):
            in_scene = scene == name
            axes.set_title(f"{name}: {int(in_scene.sum()):,}")
            axes.set(xlabel="east, m", ylabel="north, m", facecolor=style.WATER)
            axes.set_aspect("equal", adjustable="datalim")
            for outcome in outcomes:
                rows = in_scene & (all_failures.outcome == outcome)
                axes.plot(
                    all_failures.x_m[rows],
                    all_failures.y_m[rows],
                    "o",
                    color=style.OUTCOMES.get(outcome, style.QUIET),
                    markersize=2.6 if in_scene.sum() > _MANY_FAILURES else 4.0,
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


def plot_example(scene: Example) -> Figure | None:
    """What each planner made of one problem, a panel each; None without a planner."""
    if not scene.paths:
        return None
    n_columns = min(len(scene.paths), 4)
    n_rows = -(-len(scene.paths) // n_columns)
    with style.titled_figure(
        max(3.1 * n_columns, 7.5),
        3.7 * n_rows + 1.1,
        scene.title,
        "from above; a colour a robot; lighter rock is higher",
        parse_math=False,
    ) as figure:
        for axes, scene_path in zip(
            series.add_panels(figure, len(scene.paths), n_columns), scene.paths, strict=True
        ):
            axes.set_title(scene_path.planner, fontsize=10.5)
            axes.set_xlabel(_format_outcome(scene_path), fontsize=8.5)
            axes.set_aspect("equal")
            _plot_ground(axes, scene)
            for robot in range(len(scene.start_m)):
                _plot_robot(axes, scene, scene_path, robot)
        figure.legend(handles=_build_legend(scene), loc="outside lower left", ncols=4)
    return figure


def _format_outcome(scene_path: ScenePath) -> str:
    planned = int(np.sum(np.isfinite(scene_path.planned_m).all(axis=2).any(axis=1)))
    if not len(scene_path.flown_m):
        return f"not flown; {planned} of {len(scene_path.planned_m)} robots have a path"
    return f"{scene_path.outcome.count('reached')} of {len(scene_path.outcome)} robots arrived"


def _plot_ground(axes: Axes, scene: Example) -> None:
    nx, ny, nz = scene.occupied.shape
    (x, y), cell = scene.origin_m[:2], scene.cell_m
    axes.set_facecolor(style.WATER)
    top = scene.top
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
        scene.obstacle_p_m, scene.obstacle_radius_m, scene.obstacle_moves, strict=True
    ):
        color = style.OBSTACLE_DYNAMIC if moves else style.OBSTACLE_STATIC
        axes.add_patch(
            Circle((float(p[0]), float(p[1])), float(radius), color=color, alpha=0.6, zorder=2)
        )


def _plot_robot(axes: Axes, scene: Example, scene_path: ScenePath, robot: int) -> None:
    color = style.robot_color(robot)
    planned = scene_path.planned_m[robot]
    axes.plot(planned[:, 0], planned[:, 1], color=color, zorder=4, **_PLANNED)
    start, goal = scene.start_m[robot], scene.goal_m[robot]
    axes.plot(*start[:2], "o", color=color, ms=5, mec=style.PAPER, mew=0.6, zorder=6)
    axes.plot(*goal[:2], color=color, mec=style.PAPER, mew=0.6, zorder=6, **_GOAL)
    if not len(scene_path.flown_m):
        return
    flown = scene_path.flown_m[:, robot]
    axes.plot(flown[:, 0], flown[:, 1], color=color, zorder=5, path_effects=_HALO, **_FLOWN)
    finite = flown[np.isfinite(flown).all(axis=1)]
    if scene_path.outcome[robot] != "reached" and len(finite):
        axes.plot(*finite[-1, :2], color=style.INK, mec=style.PAPER, zorder=7, **_FAILURE)


def _build_legend(scene: Example) -> list[Line2D | Patch]:
    quiet = style.QUIET
    handles: list[Line2D | Patch] = [
        Line2D([], [], color=quiet, label="planned", **_PLANNED),
        Line2D([], [], color=quiet, label="flown", **_FLOWN),
        Line2D([], [], color=quiet, label="goal (disc: start)", **_GOAL),
        Line2D([], [], color=style.INK, label="failure", **_FAILURE),
    ]
    if scene.obstacle_moves.any():
        handles.append(
            Patch(color=style.OBSTACLE_DYNAMIC, alpha=0.6, label="moving obstacle, at the start")
        )
    if (~scene.obstacle_moves).any():
        handles.append(Patch(color=style.OBSTACLE_STATIC, alpha=0.6, label="still obstacle"))
    return handles
