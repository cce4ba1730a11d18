"""Speed of OMPL's planners for teams, on one core.

    python -m angler_experiments.ompl_speed --robots 1 4 8 16 --count 200

Worlds of a shipped scenario with a larger or smaller fleet; the planner has no information on
moving obstacles and current. The report gives the search alone, as others do, and all of `plan`:
preparing the compiled checks, the search, shortcuts and timing. Compiling is separate. Every path
is checked again, by closed forms of this file: the robots' spheres among cells, faces, floor, fixed
obstacles, and each other.
"""

import time
from dataclasses import replace
from typing import Literal

import numpy as np
import tyro

from angler_mjx.planning.answers import Answer, check_answer
from angler_mjx.planning.host.ompl.planners import PLANNERS
from angler_mjx.planning.problem import Problem
from angler_mjx.robot.control.commands.trajectory import Trajectory
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.scenario.scenario import load_scenario

SAMPLE_SPACING_M = 0.01
"""Spacing between the checked points of a path."""


def build_problems(scenario: str, robots: int, count: int, deadline_s: float) -> list[Problem]:
    """Build problems of worlds 0, 1 and so on.

    Args:
        scenario: name of a shipped scenario.
        robots: robots of a team; half of them (rounded up) are of the scenario's first kind.
        count: number of problems.
        deadline_s: time limit of each problem.
    """
    shipped = load_scenario(scenario)
    kinds = [kind.model_dump(exclude_unset=True) for kind in shipped.fleet[:2]]
    counts = [robots - robots // 2, robots // 2] if len(kinds) > 1 else [robots]
    fleet = [
        {**kind, "count": count_of_kind}
        for kind, count_of_kind in zip(kinds, counts, strict=True)
        if count_of_kind > 0
    ]
    loaded = load_scenario(scenario, fleet=fleet, worlds=count)
    sampled = Simulator(loaded, tile=count).problems(0, count)
    return [replace(problem, deadline_s=deadline_s) for problem in sampled]


def min_clearance_m(answer: Answer, problem: Problem) -> float:
    """Return least distance of any robot's sphere to rock, face, floor or another robot's; m."""
    paths = [path for path in answer.paths if isinstance(path, Trajectory)]
    end = max(float(path.time_s[-1]) for path in paths)
    time_s = np.linspace(0.0, end, 2 + int(end * 0.5 / SAMPLE_SPACING_M))
    position_m = np.stack(
        [
            np.stack(
                [np.interp(time_s, path.time_s, path.position_m[:, n]) for n in range(3)], axis=-1
            )
            for path in paths
        ],
        axis=1,
    )
    radius = np.asarray(problem.team.radius_m, float)
    origin, edge = np.asarray(problem.grid.origin_m, float), float(problem.grid.cell_m)
    occupied = np.asarray(problem.grid.occupied)
    low = np.maximum(origin, [-np.inf, -np.inf, float(problem.floor_z_m)])
    high = origin + edge * np.array(occupied.shape)
    clearance_m = float(
        (np.minimum(position_m - low, high - position_m).min(axis=-1) - radius).min()
    )
    for cell in np.argwhere(occupied):
        corner = origin + edge * cell
        gap = np.maximum(np.maximum(corner - position_m, position_m - corner - edge), 0.0)
        clearance_m = min(clearance_m, float((np.linalg.norm(gap, axis=-1) - radius).min()))
    for i in range(len(paths)):
        for j in range(i):
            gap = np.linalg.norm(position_m[:, i] - position_m[:, j], axis=-1)
            clearance_m = min(clearance_m, float(gap.min() - radius[i] - radius[j]))
    return clearance_m


def main(
    planner: str = "RRTConnect",
    scenario: str = "reef_fleet",
    robots: tuple[int, ...] = (1, 4, 8, 16),
    count: int = 200,
    deadline_s: float = 5.0,
    mode: Literal["composite", "prioritised"] = "composite",
    look: int = 20,
) -> None:
    """Plan and report.

    Args:
        planner: OMPL's name of the planner.
        scenario: name of a shipped scenario.
        robots: robots of each team.
        count: problems of each size.
        deadline_s: time limit of each problem.
        mode: mode of the planner.
        look: problems of each size with checked paths.
    """
    planner_class = PLANNERS[planner]
    planner_instance = planner_class(planner_class.Settings(mode=mode))
    print("robots  solved  search ms: median  p95  plan ms: median  p95  edges  nearest m")
    for team in robots:
        sampled = build_problems(scenario, team, count, deadline_s)
        planner_instance.warm_up(sampled[0])
        answers = []
        for problem in sampled:
            start_s = time.perf_counter()
            paths = planner_instance.plan(problem)
            answers.append(
                check_answer(paths, problem, time.perf_counter() - start_s, planner_instance.extras)
            )
        print(format_row(team, answers, sampled, look), flush=True)


def format_row(team: int, answers: list[Answer], problems: list[Problem], look: int) -> str:
    """Format a line of the table; times include problems without a plan."""
    solved = [answer.status == "planned" for answer in answers]
    search = 1e3 * np.array([answer.extras.get("search_s", np.nan) for answer in answers])
    whole = 1e3 * np.array([answer.planning_s for answer in answers])
    edges = np.nanmedian([answer.extras.get("edges", np.nan) for answer in answers])
    planned = [pair for pair in zip(answers, problems, strict=True) if pair[0].status == "planned"]
    clearances = [min_clearance_m(*pair) for pair in planned[:look]]
    reasons = {answer.reason for answer in answers if answer.reason}
    return (
        f"{team:6d}  {np.mean(solved):6.1%}  {np.nanmedian(search):17.3g}  "
        f"{np.nanpercentile(search, 95):.3g}  {np.median(whole):15.3g}  "
        f"{np.percentile(whole, 95):.3g}  {edges:5.0f}  {min(clearances, default=np.nan):.3f}"
        + (f"  ({'; '.join(sorted(reasons)[:3])})" if reasons else "")
    )


if __name__ == "__main__":
    tyro.cli(main)
