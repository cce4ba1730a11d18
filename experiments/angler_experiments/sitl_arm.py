"""Station keeping of a base while its arm sweeps, under a real ArduSub and under our controllers.

    python -m angler_experiments.sitl_arm --duration-s 30

At the levels of an autopilot the firmware alone steers the thrusters, and nothing of the arm is fed
forward. At the level ``thrusters`` the scenario's controllers do, with the feed-forward of the
arm's wrench and without it.
"""

from dataclasses import dataclass

import numpy as np
import tyro

from angler_mjx.errors import RunError
from angler_mjx.host_arrays import as_leaf
from angler_mjx.robot.control.commands import BodyTwist, PoseTarget
from angler_mjx.robot.control.commands.whole_body import JointTarget, WholeBodyCommand
from angler_mjx.runs.session.interface import Observation
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.sim.physics.step import require_joints
from angler_sitl.firmware.parameters import CommandLevel
from angler_sitl.session import SitlSession
from angler_sitl.steering.levels import STICK_LEVELS

SWEEP = ((0.52, 1.0, 5.2), (0.52, 0.0, 3.0), (0.52, 0.2, 3.0), (0.87, 0.0, 3.0))
"""Speed, rad/s, and ends, rad, of each joint's sweep, with a turn at once at the ends."""

HEAD = "level         feed-forward   away cm   level cm   depth cm   tilt deg   end cm"


@dataclass(frozen=True, kw_only=True)
class StationError:
    """Greatest deviations of the base from its station."""

    away_m: float
    level_m: float
    """In the horizontal plane."""
    depth_m: float
    tilt_deg: float
    end_m: float
    """Distance at the end."""

    def format_row(self, level: str, feed_forward: str) -> str:
        """Format a line of the table."""
        lengths = (100 * x for x in (self.away_m, self.level_m, self.depth_m))
        row = "".join(f"{x:11.1f}" for x in (*lengths, self.tilt_deg, 100 * self.end_m))
        return f"{level:12s}  {feed_forward:10s}{row}"


def build_scenario(duration_s: float, feed_forward: float) -> Scenario:
    """Return one robot with an arm in still water.

    Args:
        duration_s: horizon.
        feed_forward: fraction of the arm's wrench that the level ``thrusters`` feeds forward.
    """
    gains = {"link_wrench": {"present": feed_forward, "acceleration": feed_forward}}
    return Scenario.model_validate(
        {
            "name": "sitl_arm",
            "engine": "mjx",
            "time": {"horizon_s": duration_s},
            "world": {
                "preset": "open",
                "placement": "given",
                "start_m": [[0.0, 0.0, -10.0]],
                "goal_m": [[8.0, 0.0, -10.0]],
            },
            "fleet": [{"vehicle": "bluerov2_heavy_alpha5", "parameter_set": "wu2018"}],
            "controller": {"name": "arm", "gains": gains},
        }
    )


def sweep_joints(home: np.ndarray, time_s: float) -> JointTarget:
    """Return the motion of the joints at a time of the sweep; at home before it."""
    position, velocity = np.array(home, np.float32), np.zeros(home.size, np.float32)
    for j, (speed, low, high) in enumerate(SWEEP if time_s >= 0.0 else ()):
        span = high - low
        phase = np.mod(home[j] - low + speed * time_s, 2.0 * span)
        position[j] = low + span - abs(span - phase)
        velocity[j] = speed if phase < span else -speed
    still = np.zeros_like(velocity)
    return JointTarget(
        position=as_leaf(position), velocity=as_leaf(velocity), acceleration=as_leaf(still)
    )


def keep_station(
    level: CommandLevel, duration_s: float, settle_s: float, feed_forward: float
) -> StationError:
    """Return the deviations of a base from its station under an autopilot at a level.

    Args:
        level: where commands enter.
        duration_s: of the sweep.
        settle_s: before it, with the arm at home. Where the firmware chooses the station, it is the
            position at the end of that time.
        feed_forward: see `build_scenario`.
    """
    offsets, tilts = [], []
    with SitlSession(build_scenario(duration_s + settle_s, feed_forward), level=level) as session:
        position, _ = true_pose(session.observe())
        station, yaw_rad = position, as_leaf(np.zeros((), np.float32))
        base: BodyTwist | PoseTarget
        base = PoseTarget(
            position_m=as_leaf(station), velocity_mps=as_leaf(0.0 * station), yaw_rad=yaw_rad
        )
        if level in STICK_LEVELS:
            base = BodyTwist(nu=as_leaf(np.zeros(6, np.float32)))
        joints = require_joints(session.inside().state.vehicles)
        home = np.asarray(joints.position)[0, 0]
        for step in range(round((duration_s + settle_s) / session.dt_s)):
            sweep_s = step * session.dt_s - settle_s
            command = WholeBodyCommand(base=base, joints=sweep_joints(home, sweep_s))
            observation = session.step({0: command})
            if refused := observation.status[0].refused:
                raise RunError(refused)
            position, tilt_deg = true_pose(observation)
            if sweep_s < 0:
                station = position if level in STICK_LEVELS else station
                continue
            offsets.append(position - station)
            tilts.append(tilt_deg)
    moved = np.array(offsets)
    return StationError(
        away_m=float(np.linalg.norm(moved, axis=1).max()),
        level_m=float(np.linalg.norm(moved[:, :2], axis=1).max()),
        depth_m=float(np.abs(moved[:, 2]).max()),
        tilt_deg=max(tilts),
        end_m=float(np.linalg.norm(moved[-1])),
    )


def true_pose(observation: Observation) -> tuple[np.ndarray, float]:
    """Return the true position [3] of the first robot, m, in W, and its tilt, degrees."""
    truth = observation.truth or observation.estimate
    p, q = np.asarray(truth.p, np.float32)[0], np.asarray(truth.q, float)[0]
    return p, float(np.degrees(np.arccos(1.0 - 2.0 * (q[1] ** 2 + q[2] ** 2))))


def main(
    levels: tuple[CommandLevel, ...] = ("guided", "poshold", "althold", "thrusters"),
    duration_s: float = 30.0,
    settle_s: float = 10.0,
) -> None:
    """Print the deviations of the base at each level.

    Args:
        levels: Levels of commands; thrusters is flown with feed-forward and without.
        duration_s: Duration of the sweep.
        settle_s: Time before it, with the arm at home.
    """
    print(HEAD)
    for level in levels:
        for fraction in (1.0, 0.0) if level == "thrusters" else (0.0,):
            error = keep_station(level, duration_s, settle_s, fraction)
            print(error.format_row(level, "yes" if fraction else "no"), flush=True)


if __name__ == "__main__":
    tyro.cli(main)
