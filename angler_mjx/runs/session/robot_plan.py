"""Plan of one robot of a session on the host: as planned, or as rejoined."""

from dataclasses import dataclass, replace

import jax
import numpy as np
from numpy.typing import ArrayLike, DTypeLike

from angler_mjx.host_arrays import as_leaf
from angler_mjx.robot.control import plans
from angler_mjx.robot.control.commands.joint_trajectory import (
    LINEAR,
    VEHICLE_JOINTS,
    JointTrajectory,
)
from angler_mjx.robot.control.commands.trajectory import Trajectory
from angler_mjx.runs.session.interface import Floats

ACCELERATION_MPS2 = 0.25
"""Acceleration to the plan's speed."""
EASING_POINTS = 8
"""Number of way-points of the acceleration."""
TURN_RADPS = 0.6
"""Rate of turning to the heading of the plan, where it has headings."""

_ROWS = ("time_s", "position", "velocity", "acceleration", "degree")


@dataclass(frozen=True, kw_only=True)
class RobotPlan:
    """Remaining way-points of one robot."""

    time_s: Floats
    """[n] times from 0."""
    position_m: Floats
    """[n, 3] positions in W."""
    motion: JointTrajectory | None = None
    """Points of the same plan with headings and velocities, in arrays of NumPy; None where straight
    lines join them and the robot heads along its path."""

    @classmethod
    def of(cls, plan: plans.Plan) -> "RobotPlan":
        """Build the plan of one robot, in arrays of NumPy, without its padding."""
        time = np.asarray(plan.time_s, float)
        rows = int(np.searchsorted(time, time[-1])) + 1
        if isinstance(plan, Trajectory):
            return cls(time_s=time[:rows], position_m=np.asarray(plan.position_m, float)[:rows])
        rows = max(rows, 2)
        return cls._from_motion(
            replace(
                plan,
                time_s=as_leaf(time[:rows]),
                position=as_leaf(np.asarray(plan.position, float)[:rows]),
                velocity=as_leaf(np.asarray(plan.velocity, float)[:rows]),
                acceleration=as_leaf(np.asarray(plan.acceleration, float)[:rows]),
                degree=as_leaf(np.asarray(plan.degree)[:rows]),
                found=None,
            )
        )

    @classmethod
    def _from_motion(cls, motion: JointTrajectory) -> "RobotPlan":
        position = np.asarray(motion.position)
        return cls(time_s=np.asarray(motion.time_s), position_m=position[:, :3], motion=motion)

    @property
    def kind(self) -> type:
        """Return the type of the command."""
        return Trajectory if self.motion is None else JointTrajectory

    def at(self, time_s: ArrayLike) -> Floats:
        """Return positions [..., 3] at times [...]."""
        times = np.asarray(time_s, float)
        if self.motion is not None:
            joints = plans.joints_at(self.motion, times.ravel()).position
            positions: Floats = np.asarray(joints)[:, :3].reshape(*times.shape, 3)
            return positions
        points = [np.interp(times, self.time_s, self.position_m[:, i]) for i in range(3)]
        positions = np.stack(points, axis=-1)
        return positions

    def after(
        self,
        detour_m: Floats,
        arrive_s: Floats,
        join_s: float,
        yaw_rad: float,
        arm: Floats | None = None,
    ) -> "RobotPlan":
        """Return a detour to the position of this plan at a time, followed by the plan from there.

        Args:
            detour_m: [n, 3] corners of the detour, the position of the plan last.
            arrive_s: [n] times of the corners.
            join_s: the plan's time at the last corner.
            yaw_rad: heading of the robot at the beginning; a plan with headings is joined at its
                heading, the detour lasting at least as long as the turn.
            arm: [J] positions of the arm's joints at the beginning, rad or m; a plan with joints
                is joined at its joints, which move evenly over the detour. None without an arm.
        """
        is_later = self.time_s > join_s + 1e-6
        if self.motion is None:
            return RobotPlan(
                time_s=np.concatenate([arrive_s, self.time_s[is_later] - join_s + arrive_s[-1]]),
                position_m=np.concatenate([detour_m, self.position_m[is_later]]),
            )
        join_state = plans.joints_at(self.motion, [join_s])
        turn = np.mod(join_state.position[0, 3] - yaw_rad + np.pi, 2 * np.pi) - np.pi
        arrival_s = _stretch_times(arrive_s, abs(float(turn)) / TURN_RADPS)
        fraction = arrival_s / max(arrival_s[-1], 1e-9)
        heading = join_state.position[0, 3] - turn * (1.0 - fraction)
        arm_end = join_state.position[0, len(VEHICLE_JOINTS) :]
        arm_begin = arm_end if arm is None else arm
        arm_rows = arm_end - (arm_end - arm_begin) * (1.0 - fraction)[:, None]
        table = np.column_stack([detour_m, heading, arm_rows])
        table[-1] = join_state.position[0]
        zeros = np.zeros_like(table)
        detour_rows = {
            "time_s": arrival_s,
            "position": table,
            "velocity": np.concatenate([zeros[:-1], join_state.velocity]),
            "acceleration": np.concatenate([zeros[:-1], join_state.acceleration]),
            "degree": np.append(
                np.full(len(detour_m) - 1, LINEAR), self._degrees_at(self.motion, [join_s])
            ),
        }
        later_rows = {name: np.asarray(getattr(self.motion, name))[is_later] for name in _ROWS}
        later_rows["time_s"] = later_rows["time_s"] - join_s + arrival_s[-1]
        return self._from_rows(
            self.motion,
            {name: np.concatenate([detour_rows[name], later_rows[name]]) for name in _ROWS},
        )

    def eased(self, speed_fraction: float, speed_mps: float) -> "RobotPlan":
        """Return the same path, begun at a fraction of its speed that grows evenly to 1.

        The plan's time t goes by as t = r s + (1 - r) s^2 / (2 T) for s < T, and as fast as the
        new time s from then on.

        Args:
            speed_fraction: r.
            speed_mps: initial speed of the plan.
        """
        rest = 1.0 - speed_fraction
        ramp = rest * speed_mps / ACCELERATION_MPS2
        if ramp < 1e-3:
            return self
        s = np.linspace(0.0, ramp, EASING_POINTS + 1)[1:]
        t = speed_fraction * s + rest * s**2 / (2.0 * ramp)
        ramped_s = np.minimum(self.time_s, t[-1])
        root = np.sqrt(speed_fraction**2 + 2.0 * rest * ramped_s / ramp)
        corners = (root - speed_fraction) * ramp / rest + (self.time_s - ramped_s)
        time, first = np.unique(np.concatenate([corners, s]), return_index=True)
        if self.motion is None:
            positions = np.concatenate([self.position_m, self.at(t)])
            return RobotPlan(time_s=time, position_m=positions[first])
        sampled = plans.joints_at(self.motion, t)

        def rows(name: str) -> np.ndarray:
            stored = np.asarray(getattr(self.motion, name))
            return np.concatenate([stored, getattr(sampled, name)])[first]

        rate = np.minimum(speed_fraction + rest * time / ramp, 1.0)[:, None]
        gain = np.where(time < ramp, rest / ramp, 0.0)[:, None]
        velocity = rows("velocity")
        degree = np.concatenate([np.asarray(self.motion.degree), self._degrees_at(self.motion, t)])[
            first
        ]
        return self._from_rows(
            self.motion,
            {
                "time_s": time,
                "position": rows("position"),
                "velocity": velocity * rate,
                "acceleration": rows("acceleration") * rate**2 + velocity * gain,
                "degree": degree,
            },
        )

    def padded(self, rows: int, dtype: DTypeLike) -> plans.Plan:
        """Return the plan for the controllers, with a number of rows; arrays of NumPy."""
        n_missing = rows - self.time_s.size

        def edge(values: ArrayLike, like: DTypeLike = dtype) -> jax.Array:
            padding = [(0, n_missing)] + [(0, 0)] * (np.ndim(values) - 1)
            return as_leaf(np.pad(values, padding, mode="edge").astype(like))

        if self.motion is None:
            return Trajectory(
                time_s=edge(self.time_s),
                position_m=edge(self.position_m),
                found=as_leaf(np.asarray(True)),
            )
        return replace(
            self.motion,
            time_s=edge(self.motion.time_s),
            position=edge(self.motion.position),
            velocity=edge(self.motion.velocity),
            acceleration=edge(self.motion.acceleration),
            degree=edge(self.motion.degree, np.int32),
        )

    def _degrees_at(self, motion: JointTrajectory, time_s: ArrayLike) -> np.ndarray:
        """Return degrees of the segments [n] of the plan's motion at times [n]."""
        k = np.searchsorted(self.time_s, np.asarray(time_s, float), side="right") - 1
        return np.asarray(motion.degree)[np.clip(k, 0, self.time_s.size - 1)]

    @classmethod
    def _from_rows(cls, motion: JointTrajectory, rows: dict[str, np.ndarray]) -> "RobotPlan":
        """Build a plan of the joints of a motion with other points."""
        leaves = {name: as_leaf(values) for name, values in rows.items()}
        return cls._from_motion(
            replace(
                motion,
                time_s=leaves["time_s"],
                position=leaves["position"],
                velocity=leaves["velocity"],
                acceleration=leaves["acceleration"],
                degree=leaves["degree"],
            )
        )


def _stretch_times(arrive_s: Floats, min_duration_s: float) -> Floats:
    """Return times [n] from 0, stretched to a minimum duration."""
    if arrive_s[-1] >= min_duration_s:
        return arrive_s
    if arrive_s[-1] > 0.0:
        stretched: Floats = arrive_s * (min_duration_s / arrive_s[-1])
        return stretched
    return np.append(arrive_s[:-1], min_duration_s)
