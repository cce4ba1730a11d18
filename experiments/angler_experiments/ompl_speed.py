"""How fast OMPL's planners plan for teams, on one core.

    python -m angler_experiments.ompl_speed --robots 1 4 8 16 --count 200

Worlds of a shipped scenario whose fleet is made larger or smaller; what moves in them is not known
to the planner, nor is the current. Reported are the search alone, which is what others report, and
all of `plan`: making the compiled checks ready, the search, shortcuts and timing. Compiling is
apart. Every path is looked at anew, by closed forms of this file: the robots' spheres among cells,
faces, floor, obstacles that stand, and each other.
"""

import time
from dataclasses import replace
from typing import Literal

import numpy as np
import tyro

from angler_mjx.planning.answers import Answer, answer
from angler_mjx.planning.host.ompl.planners import PLANNERS
from angler_mjx.planning.problem import Problem
from angler_mjx.robot.control.trajectory import Trajectory
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.scenario.scenario import load_scenario

APART_M = 0.01
"""Between the places of a path that are looked at."""


def problems(scenario: str, robots: int, count: int, deadline_s: float) -> list[Problem]:
    """Problems of worlds 0, 1 and on.

    Args:
        scenario: name of a shipped one.
        robots: of a team; half of them (rounded up) are of the scenario's first kind.
        count: of problems.
        deadline_s: of each.
    """
    shipped = load_scenario(scenario)
    kinds = [kind.model_dump(exclude_unset=True) for kind in shipped.fleet[:2]]
    shares = [robots - robots // 2, robots // 2] if len(kinds) > 1 else [robots]
    fleet = [
        {**kind, "count": share} for kind, share in zip(kinds, shares, strict=True) if share > 0
    ]
    loaded = load_scenario(scenario, fleet=fleet, worlds=count)
    drawn = Simulator(loaded, tile=count).problems(0, count)
    return [replace(problem, deadline_s=deadline_s) for problem in drawn]


def nearest(given: Answer, problem: Problem) -> float:
    """Least distance of any robot's sphere to rock, face, floor or another robot's; m."""
    paths = [path for path in given.paths if isinstance(path, Trajectory)]
    end = max(float(path.time_s[-1]) for path in paths)
    when = np.linspace(0.0, end, 2 + int(end * 0.5 / APART_M))
    place = np.stack(
        [
            np.stack(
                [np.interp(when, path.time_s, path.position_m[:, n]) for n in range(3)], axis=-1
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
    least = float((np.minimum(place - low, high - place).min(axis=-1) - radius).min())
    for cell in np.argwhere(occupied):
        corner = origin + edge * cell
        gap = np.maximum(np.maximum(corner - place, place - corner - edge), 0.0)
        least = min(least, float((np.linalg.norm(gap, axis=-1) - radius).min()))
    for i in range(len(paths)):
        for j in range(i):
            gap = np.linalg.norm(place[:, i] - place[:, j], axis=-1)
            least = min(least, float(gap.min() - radius[i] - radius[j]))
    return least


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
        planner: OMPL's name.
        scenario: name of a shipped one.
        robots: of each team.
        count: problems of each size.
        deadline_s: of each problem.
        mode: of the planner.
        look: problems of each size whose paths are looked at anew.
    """
    kind = PLANNERS[planner]
    asked = kind(kind.Settings(mode=mode))
    print("robots  solved  search ms: median  p95  plan ms: median  p95  edges  nearest m")
    for team in robots:
        drawn = problems(scenario, team, count, deadline_s)
        asked.warm_up(drawn[0])
        answers = []
        for problem in drawn:
            begin = time.perf_counter()
            paths = asked.plan(problem)
            answers.append(answer(paths, problem, time.perf_counter() - begin, asked.extras))
        print(row(team, answers, drawn, look), flush=True)


def row(team: int, answers: list[Answer], drawn: list[Problem], look: int) -> str:
    """One line of the table; all problems count in the times, those without a plan as they took."""
    solved = [one.status == "planned" for one in answers]
    search = 1e3 * np.array([one.extras.get("search_s", np.nan) for one in answers])
    whole = 1e3 * np.array([one.planning_s for one in answers])
    edges = np.nanmedian([one.extras.get("edges", np.nan) for one in answers])
    good = [pair for pair in zip(answers, drawn, strict=True) if pair[0].status == "planned"]
    looked = [nearest(*pair) for pair in good[:look]]
    reasons = {one.reason for one in answers if one.reason}
    return (
        f"{team:6d}  {np.mean(solved):6.1%}  {np.nanmedian(search):17.3g}  "
        f"{np.nanpercentile(search, 95):.3g}  {np.median(whole):15.3g}  "
        f"{np.percentile(whole, 95):.3g}  {edges:5.0f}  {min(looked, default=np.nan):.3f}"
        + (f"  ({'; '.join(sorted(reasons)[:3])})" if reasons else "")
    )


if __name__ == "__main__":
    tyro.cli(main)
