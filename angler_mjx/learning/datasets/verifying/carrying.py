"""Checks of recorded grips, and of the body that robots hold together."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from angler_mjx.runs.storage.folder import Run
from angler_mjx.scenario.carry_table import CarryTask
from angler_mjx.sim.cargo import CargoSpec

GRIP_ARRAYS = ("grips/held", "grips/wrench")
"""Arrays of runs that record grips."""
POSE_ARRAYS = ("obstacle_p_m", "obstacle_q")
END_ARRAYS = ("end/step", "end/obstacle_p_m", "end/obstacle_q")
MAX_SLIP_M = 1e-3
"""Offset of a robot from its weld, beyond what rounding allows."""
ERROR_M, ERROR_RAD = 1e-5, 1e-5
"""Tolerances of the body's error at its goal, of float32."""


@dataclass(frozen=True, kw_only=True)
class GripCheck:
    """Properties of a part by which its grips are checked."""

    cargo: CargoSpec
    slip_m: float | None
    """Offset of a robot from its grip that is no fault; None where it is not in the record."""
    break_force_n: float
    """Force at which grips break; inf for never."""
    control_dt_s: float
    columns: Mapping[str, np.ndarray]
    """[w, r] of the episode table."""

    @classmethod
    def of(cls, run: Run) -> "GripCheck | None":
        """Return the check of a part; None where its robots hold nothing together."""
        scenario = run.scenario
        task = scenario.task
        if not isinstance(task, CarryTask):
            return None
        step_m = 1e-3 * (scenario.store.position_mm or 0.0)
        step_rad = 1e-3 * (scenario.store.attitude_mrad or 0.0)
        reach_m = max(np.linalg.norm(np.subtract(a, task.to_m)) for a in scenario.world.goal_m)
        by_hull = task.hold == "hull"
        robots = len(scenario.members())
        names = ("time_to_goal_s", "failure_time_s", "cargo_distance_m", "cargo_angle_rad")
        return cls(
            cargo=task.cargo,
            slip_m=MAX_SLIP_M + 2.0 * step_m + 2.0 * reach_m * step_rad if by_hull else None,
            break_force_n=np.inf if task.break_force_n is None else task.break_force_n,
            control_dt_s=scenario.time.control_dt_s,
            columns={
                name: run.episodes[name].to_numpy(zero_copy_only=False).reshape(-1, robots)
                for name in names
            },
        )

    def find_faults(
        self, arrays: Mapping[str, np.ndarray], running: np.ndarray
    ) -> dict[str, np.ndarray]:
        """Return the faulty samples, bool [w, t, r], by the name of their array.

        Args:
            arrays: [w, t, r, ...] robots' poses and grips, [w, t, o, ...] poses of obstacles.
            running: bool [w, t, r] whether the robot's episode lasts.
        """
        held, wrench = (arrays[name] for name in GRIP_ARRAYS)
        force_n = np.linalg.norm(wrench[..., :3], axis=-1)
        faults = {
            "grips/held": running & (held != 1),
            "grips/wrench": running
            & ~(np.isfinite(wrench).all(-1) & (force_n <= self.break_force_n)),
        }
        if self.slip_m is not None:
            body_p, body_q = (arrays[name][:, :, self.cargo.body, None] for name in POSE_ARRAYS)
            offset = np.where(running[..., None], arrays["p_m"] - body_p, 0.0)
            turn = np.where(running[..., None], body_q, [1.0, 0.0, 0.0, 0.0])
            by_robot = Rotation.from_quat(turn.reshape(-1, 4), scalar_first=True)
            in_body = by_robot.inv().apply(offset.reshape(-1, 3)).reshape(offset.shape)
            slip_m = np.linalg.norm(in_body - in_body[:, :1], axis=-1)
            faults["grips/held"] |= running & (held == 1) & (slip_m > self.slip_m)
        return faults

    def find_wrong_errors(
        self, first: int, start_q: np.ndarray, ends: Mapping[str, np.ndarray]
    ) -> dict[str, np.ndarray]:
        """Return the robots, bool [w, r], whose column differs from the body's last state.

        Of robots whose episodes end with that state.

        Args:
            first: index of the first world.
            start_q: [w, 4] attitude of the body at the start.
            ends: arrays of the last states, [w, ...].
        """
        step, p, q = (ends[name] for name in END_ARRAYS)
        rows = slice(first, first + len(step))
        end_s = np.fmax(self.columns["time_to_goal_s"][rows], self.columns["failure_time_s"][rows])
        is_last = np.abs(end_s - step[:, None] * self.control_dt_s) < 0.5 * self.control_dt_s
        body = self.cargo.body
        distance = np.linalg.norm(p[:, body] - np.array(self.cargo.goal_m), axis=-1)
        start = Rotation.from_quat(start_q, scalar_first=True)
        wanted = Rotation.from_rotvec([0.0, 0.0, self.cargo.turn_rad]) * start
        angle = (wanted.inv() * Rotation.from_quat(q[:, body], scalar_first=True)).magnitude()
        judged = {"cargo_distance_m": (distance, ERROR_M), "cargo_angle_rad": (angle, ERROR_RAD)}
        return {
            name: is_last & ~(np.abs(self.columns[name][rows] - value[:, None]) <= tolerance)
            for name, (value, tolerance) in judged.items()
        }
