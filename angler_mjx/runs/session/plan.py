"""The plan of one robot of a session on the host: as it was planned, or as it is taken up again."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from angler_mjx.robot.control import plans
from angler_mjx.robot.control.joint_trajectory import LINEAR, VEHICLE_JOINTS, JointTrajectory
from angler_mjx.robot.control.trajectory import Trajectory
from angler_mjx.runs.session.interface import Floats

ACCELERATION_MPS2 = 0.25
"""At which the plan's speed is taken up."""
EASING_POINTS = 8
"""Way-points on which it is."""
TURN_RADPS = 0.6
"""At which a robot turns to the heading of its plan, where that has one."""

_ROWS = ("time_s", "position", "velocity", "acceleration", "degree")


@dataclass(frozen=True, kw_only=True)
class Plan:
    """Way-points of one robot, as far as they are still to be gone."""

    time_s: Floats
    """[n] from 0."""
    position_m: Floats
    """[n, 3]."""
    motion: JointTrajectory | None = None
    """The same points with headings and velocities, in arrays of NumPy; None where lines join them
    and the robot looks where it goes."""

    @classmethod
    def of(cls, plan: plans.Plan) -> "Plan":
        """A plan of one robot, in arrays of NumPy, without its padding."""
        time = np.asarray(plan.time_s, float)
        rows = int(np.searchsorted(time, time[-1])) + 1
        if isinstance(plan, Trajectory):
            return cls(time_s=time[:rows], position_m=np.asarray(plan.position_m, float)[:rows])
        rows = max(rows, 2)
        real: dict[str, Any] = {
            name: np.asarray(getattr(plan, name), float)[:rows] for name in _ROWS[:-1]
        }
        degree: Any = np.asarray(plan.degree)[:rows]
        return cls._moving(replace(plan, degree=degree, found=None, **real))

    @classmethod
    def _moving(cls, motion: JointTrajectory) -> "Plan":
        position = np.asarray(motion.position)
        return cls(time_s=np.asarray(motion.time_s), position_m=position[:, :3], motion=motion)

    @property
    def kind(self) -> type:
        """Type of the command."""
        return Trajectory if self.motion is None else JointTrajectory

    def at(self, time_s: Any) -> Floats:
        """Positions [..., 3] at times [...]."""
        times = np.asarray(time_s, float)
        if self.motion is not None:
            there = plans.joints_at(self.motion, times.ravel()).position
            found: Floats = np.asarray(there)[:, :3].reshape(*times.shape, 3)
            return found
        points = [np.interp(times, self.time_s, self.position_m[:, i]) for i in range(3)]
        found = np.stack(points, axis=-1)
        return found

    def after(self, way: Floats, arrive_s: Floats, join_s: float, yaw_rad: float) -> "Plan":
        """A way to the place of this plan at a time, and this plan from there on.

        Args:
            way: [n, 3] corners of the way, the place of the plan last.
            arrive_s: [n] when they are reached.
            join_s: the plan's time there.
            yaw_rad: the robot's at its beginning; a plan with headings is joined at its own, the
                way taking as long as the turn does.
        """
        later = self.time_s > join_s + 1e-6
        if self.motion is None:
            return Plan(
                time_s=np.concatenate([arrive_s, self.time_s[later] - join_s + arrive_s[-1]]),
                position_m=np.concatenate([way, self.position_m[later]]),
            )
        here = plans.joints_at(self.motion, [join_s])
        turn = np.mod(here.position[0, 3] - yaw_rad + np.pi, 2 * np.pi) - np.pi
        arrive = _no_faster(arrive_s, abs(float(turn)) / TURN_RADPS)
        share = arrive / max(arrive[-1], 1e-9)
        heading = here.position[0, 3] - turn * (1.0 - share)
        table = np.column_stack([way, heading])
        table[-1] = here.position[0]
        zeros = np.zeros_like(table)
        before = {
            "time_s": arrive,
            "position": table,
            "velocity": np.concatenate([zeros[:-1], here.velocity]),
            "acceleration": np.concatenate([zeros[:-1], here.acceleration]),
            "degree": np.append(np.full(len(way) - 1, LINEAR), self._degree([join_s])),
        }
        rest = {name: np.asarray(getattr(self.motion, name))[later] for name in _ROWS}
        rest["time_s"] = rest["time_s"] - join_s + arrive[-1]
        return self._with({name: np.concatenate([before[name], rest[name]]) for name in _ROWS})

    def eased(self, share: float, speed_mps: float) -> "Plan":
        """The same way, begun at a share of its speed that grows to the whole evenly.

        The plan's time t goes by as t = r s + (1 - r) s^2 / (2 T) for s < T, and as fast as the
        new time s from then on.

        Args:
            share: r.
            speed_mps: that the plan begins with.
        """
        rest = 1.0 - share
        ramp = rest * speed_mps / ACCELERATION_MPS2
        if ramp < 1e-3:
            return self
        s = np.linspace(0.0, ramp, EASING_POINTS + 1)[1:]
        t = share * s + rest * s**2 / (2.0 * ramp)
        begun = np.minimum(self.time_s, t[-1])
        root = np.sqrt(share**2 + 2.0 * rest * begun / ramp)
        corners = (root - share) * ramp / rest + (self.time_s - begun)
        time, first = np.unique(np.concatenate([corners, s]), return_index=True)
        if self.motion is None:
            place = np.concatenate([self.position_m, self.at(t)])
            return Plan(time_s=time, position_m=place[first])
        between = plans.joints_at(self.motion, t)

        def rows(name: str) -> Any:
            own = np.asarray(getattr(self.motion, name))
            return np.concatenate([own, getattr(between, name)])[first]

        rate = np.minimum(share + rest * time / ramp, 1.0)[:, None]
        gain = np.where(time < ramp, rest / ramp, 0.0)[:, None]
        velocity = rows("velocity")
        degree = np.concatenate([np.asarray(self.motion.degree), self._degree(t)])[first]
        return self._with(
            {
                "time_s": time,
                "position": rows("position"),
                "velocity": velocity * rate,
                "acceleration": rows("acceleration") * rate**2 + velocity * gain,
                "degree": degree,
            }
        )

    def padded(self, rows: int, dtype: Any) -> plans.Plan:
        """As the controllers take it, in so many rows; arrays of NumPy."""
        more = rows - self.time_s.size

        def edge(values: Any, like: Any) -> Any:
            padding = [(0, more)] + [(0, 0)] * (np.ndim(values) - 1)
            return np.pad(values, padding, mode="edge").astype(like)

        if self.motion is None:
            found: Any = np.asarray(True)
            return Trajectory(
                time_s=edge(self.time_s, dtype),
                position_m=edge(self.position_m, dtype),
                found=found,
            )
        real: dict[str, Any] = {
            name: edge(getattr(self.motion, name), dtype) for name in _ROWS[:-1]
        }
        return replace(self.motion, degree=edge(self.motion.degree, np.int32), **real)

    def _degree(self, time_s: Any) -> Any:
        """Of the segments [n] that times [n] lie on."""
        k = np.searchsorted(self.time_s, np.asarray(time_s, float), side="right") - 1
        motion: Any = self.motion
        return np.asarray(motion.degree)[np.clip(k, 0, self.time_s.size - 1)]

    @classmethod
    def _with(cls, rows: dict[str, Any]) -> "Plan":
        commanded: Any = np.ones(len(VEHICLE_JOINTS), bool)
        return cls._moving(JointTrajectory(joints=VEHICLE_JOINTS, commanded=commanded, **rows))


def _no_faster(arrive_s: Floats, least_s: float) -> Floats:
    """Times [n] from 0, stretched to at least so long."""
    if arrive_s[-1] >= least_s:
        return arrive_s
    if arrive_s[-1] > 0.0:
        stretched: Floats = arrive_s * (least_s / arrive_s[-1])
        return stretched
    return np.append(arrive_s[:-1], least_s)
