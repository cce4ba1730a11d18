"""Formation for the scenario ``sitl_formation``: a square of robots that moves, turns and widens.

    python -m angler_experiments.sitl_formation formation.json
    angler sitl run sitl_formation --plan formation.json

Robot i goes along p_i(t) = c(t) + k(t) R(theta(t)) d_i with one smooth step sigma(t / T) in c, k
and theta; d_i are the starts about their middle. No two robots come nearer to each other than at
the start, for the square never shrinks.
"""

import math
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from angler_mjx.report.interop import joint_trajectory_file
from angler_mjx.robot.control.commands.joint_goal import JointGoal, JointPoint
from angler_mjx.scenario.scenario import load_scenario

SCENARIO = "sitl_formation"
MOVE_S, HOLD_S, STEP_S = 60.0, 10.0, 4.0
SHIFT_M = np.array([9.0, 0.0, -2.0])
TURN_RAD, WIDENING = math.pi / 2, 1.2
_H_S = 1e-3
"""Step of finite differences of positions."""


def robot_positions(start_m: np.ndarray, time_s: float) -> np.ndarray:
    """Return the reference positions of the robots [n, 3], m in W.

    Args:
        start_m: [n, 3] start positions.
        time_s: time since the start.
    """
    fraction = min(max(time_s / MOVE_S, 0.0), 1.0)
    # At rest, without acceleration, at both ends.
    progress = fraction**3 * (10.0 + fraction * (6.0 * fraction - 15.0))
    middle = start_m.mean(axis=0)
    cos, sin = math.cos(TURN_RAD * progress), math.sin(TURN_RAD * progress)
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    widening = 1.0 + (WIDENING - 1.0) * progress
    positions_m: np.ndarray = middle + progress * SHIFT_M + widening * (start_m - middle) @ turn.T
    return positions_m


def build_goals(start_m: np.ndarray) -> dict[int, JointGoal]:
    """Build a JointTrajectory for each robot, held at its end for a while."""
    times = np.append(np.arange(0.0, MOVE_S + STEP_S / 2, STEP_S), MOVE_S + HOLD_S)
    p, before, after = (
        np.stack([robot_positions(start_m, t + shift) for t in times])
        for shift in (0.0, -_H_S, _H_S)
    )
    v, a = (after - before) / (2 * _H_S), (after - 2 * p + before) / _H_S**2
    v[[0, -1]], a[[0, -1]] = 0.0, 0.0

    def row(table: np.ndarray, k: int, i: int) -> tuple[float, ...]:
        return tuple(np.round(table[k, i], 9).tolist())

    return {
        i: JointGoal(
            joint_names=("x", "y", "z"),
            points=tuple(
                JointPoint(
                    time_s=float(t),
                    positions=row(p, k, i),
                    velocities=row(v, k, i),
                    accelerations=row(a, k, i),
                )
                for k, t in enumerate(times)
            ),
        )
        for i in range(len(start_m))
    }


def main(out: Annotated[Path, tyro.conf.Positional], force: bool = False) -> None:
    """Write the trajectories of the formation.

    Args:
        out: File to write.
        force: Replace an older file.
    """
    start_m = np.array(load_scenario(SCENARIO).world.start_m)
    joint_trajectory_file.write_trajectories(out, build_goals(start_m), force=force)
    print(out)


if __name__ == "__main__":
    tyro.cli(main)
