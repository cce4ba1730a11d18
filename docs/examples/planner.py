"""Plan paths by a class of a few lines, fly them, and check the planner's contract.

A planner receives one world as arrays, and returns a path or a reason for each robot. On the
command line: `angler rollout reef_fleet --planner docs/examples/planner.py:OverTheRock`
"""

import numpy as np

import angler_mjx as angler
from angler_mjx.testing import check_planner

ABOVE_M = 1.0


class OverTheRock:
    """Up to the depth below the surface, across at that depth, down to the goal."""

    def plan(self, problem: angler.Problem) -> list[angler.Trajectory | angler.NoPlan]:
        """Return a path of four points for each robot, a metre below the surface."""
        paths = []
        for i, start in enumerate(problem.team.start_m):
            goal = problem.team.goal_m[i]
            depth = -problem.team.radius_m[i] - ABOVE_M * (1 + i)  # robots keep apart by depth
            over = [[*start[:2], depth], [*goal[:2], depth]]
            points = np.array([start, *over, goal])
            lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
            times = np.concatenate([[0], np.cumsum(lengths)]) / problem.team.cruise_speed_mps[i]
            if times[-1] > problem.horizon_s:
                paths.append(angler.NoPlan("the way over the rock takes too long"))
            else:
                paths.append(angler.way_points(times, points))
        return paths


def main() -> list[str]:
    """Check the planner on two worlds; return its reasons and lengths of paths."""
    scenario = angler.load_scenario("reef_fleet", worlds=4, tile=4)
    problems = angler.Simulator(scenario).problems(0, 2)
    check_planner(OverTheRock, problems)
    answers = []
    for path in OverTheRock().plan(problems[0]):
        is_path = isinstance(path, angler.Trajectory)
        answers.append(f"{float(path.time_s[-1]):.0f} s" if is_path else path.reason)
    print(answers)
    return answers


if __name__ == "__main__":
    main()
