"""Comparison of one robot's stored results with the judged ones, finding by finding."""

import numpy as np

from angler_mjx.testing.referee import carrying
from angler_mjx.testing.referee.findings import (
    CARGO_M,
    CARGO_RAD,
    TASK_QUANTITIES,
    CheckMethod,
    FindingResult,
    RefereeFinding,
    Value,
)
from angler_mjx.testing.referee.geometry import Floats
from angler_mjx.testing.referee.record import OUTCOMES
from angler_mjx.testing.referee.scene import FAILED, RefereeScene
from angler_mjx.testing.referee.teamwork import NEVER

TIME_ULPS = 4.0
"""Tolerance of times, which are sums and products of two float32."""

PROGRESS_TOLERANCE = 1e-6
"""Tolerance of a fraction of jobs or cells, in float32."""

POSITION_COLUMNS = ("failure_x_m", "failure_y_m", "failure_z_m")


class FindingCollector:
    """Collector of one robot's findings."""

    def __init__(self, scene: RefereeScene, robot: int) -> None:
        """Create a collector without findings."""
        self.findings: list[RefereeFinding] = []
        self.row = scene.rows[robot]
        self._scene, self._robot = scene, robot

    def _add_finding(
        self,
        quantity: str,
        how: CheckMethod,
        result: FindingResult,
        *,
        stored: Value,
        judged: Value,
        deviation: float = 0.0,
        tolerance: float = 0.0,
        note: str = "",
    ) -> None:
        world = self._scene.world.index
        self.findings.append(
            RefereeFinding(
                world=world,
                robot=self._robot,
                quantity=quantity,
                how=how,
                result=result,
                stored=stored,
                judged=judged,
                deviation=deviation,
                tolerance=tolerance,
                note=note,
            )
        )

    def add_verdict(
        self,
        quantity: str,
        how: CheckMethod,
        stored: Value,
        judged: Value,
        result: FindingResult,
        note: str = "",
    ) -> None:
        """Add a verdict on a stored and a judged value."""
        self._add_finding(quantity, how, result, stored=stored, judged=judged, note=note)

    def number(
        self, quantity: str, judged: float, tolerance: float, *, relative: bool = False
    ) -> None:
        """Add a recomputed number."""
        stored = float(self.row[quantity])
        is_same = stored == judged or (np.isnan(stored) and np.isnan(judged))
        difference = 0.0 if is_same else abs(stored - judged)
        agrees = difference <= tolerance
        if relative:
            scale = max(abs(judged), tolerance)
            difference, tolerance = difference / scale, tolerance / scale
        self._add_finding(
            quantity,
            "exact",
            "agrees" if agrees else "disagrees",
            stored=stored,
            judged=judged,
            deviation=float(difference) if np.isfinite(difference) else float("inf"),
            tolerance=tolerance,
        )

    def add_bounded(self, quantity: str, low: float, high: float, why: str) -> None:
        """Add a number that is only known to lie between two limits."""
        stored = float(self.row[quantity])
        inside = low <= stored <= high
        self._add_finding(
            quantity,
            "bounded",
            "agrees" if inside else "disagrees",
            stored=stored,
            judged=f"{low:.6g} to {high:.6g}",
            note=why,
        )

    def unchecked(self, quantity: str, why: str) -> None:
        """Add a quantity that the record does not determine."""
        value = self.row.get(quantity)
        self._add_finding(quantity, "unchecked", "agrees", stored=value, judged=None, note=why)

    def time(self, judged_s: float, how: CheckMethod, result: FindingResult, note: str) -> None:
        """Add the end time, exact to the step."""
        stored = self._scene.stored_end_s(self._robot)
        apart = abs(stored - judged_s)
        rounding = TIME_ULPS * float(np.spacing(np.float32(max(judged_s, 1.0))))
        agrees = apart <= rounding
        if agrees or result == "agrees":
            result = "agrees" if agrees else "disagrees"
        self._add_finding(
            "end_time_s",
            how,
            result,
            stored=stored,
            judged=judged_s,
            deviation=apart if np.isfinite(apart) else float("inf"),
            tolerance=rounding,
            note="" if agrees else note,
        )

    def touch(self, last: int) -> None:
        """Add what contact did to a robot in a run in which it ends no episode.

        Forces and energies are not in the record; what the limit of damage says of them is.

        Args:
            last: state of the robot's end.
        """
        scene, outcome = self._scene, self._scene.stored_outcome(self._robot)
        limit = scene.run.damage_energy_j
        low, high = (0.0, float("inf"))
        if limit is not None:
            low, high = (limit, high) if outcome == "damaged" else (low, limit)
        self.add_bounded("impact_energy_j", low, high, "what damages a robot is above the limit")
        deepest = 0.0
        if scene.run.carry is None or not scene.run.carry.by_end_effector:  # they reach into it
            nearby = scene.near_until(self._robot, last)
            deepest = nearby.clearance_m(self._robot, last)
            deepest = min(deepest, nearby.separation_m(self._robot, last))
        self.add_bounded("contact_depth_m", 0.0, float("inf"), "states show no step between them")
        pair, speed = self.row["failure_pair"], float(self.row["impact_speed_mps"])
        touched = pair != "none"
        if touched == (not np.isnan(speed)) and (touched or deepest > -scene.contact_band_m):
            for name in ("failure_pair", "impact_speed_mps"):
                self.unchecked(name, "the record holds no impacts")
            return
        self._add_finding("failure_pair", "bounded", "disagrees", stored=pair, judged="none")
        self._add_finding("impact_speed_mps", "bounded", "disagrees", stored=speed, judged=None)

    def carry(self, last: int) -> None:
        """Add the pose of the held body at a robot's end, and its grip until then.

        Args:
            last: state of the robot's end, or the last one before it.
        """
        scene, robot = self._scene, self._robot
        rules, run = scene.run.carry, scene.run
        if rules is None:
            return
        has_end = scene.stored_step[robot] == int(scene.world.step[last])
        for name, values, tolerance in zip(
            ("cargo_distance_m", "cargo_angle_rad"),
            carrying.find_error(rules, scene.cargo),
            (max(CARGO_M, scene.contact_band_m), CARGO_RAD),
            strict=True,
        ):
            if has_end:
                self.number(name, float(values[last]), tolerance)
            else:
                self.unchecked(name, "what was between the samples is not known")
        dropped = scene.stored_outcome(robot) == "dropped"
        low, high = 0.0, float("inf")
        if scene.world.grip_wrench is not None:
            forces = np.linalg.norm(scene.world.grip_wrench[: last + 1, robot, :3], axis=1)
            low = float(np.max(forces, initial=0.0)) * (1.0 - 1e-5)
        if rules.break_force_n is not None:
            low = max(low, rules.break_force_n) if dropped else low
            high = high if dropped else rules.break_force_n
        self.add_bounded("grip_force_n", low, high, "of means over control periods and the limit")
        strongest = max(float(row["grip_force_n"]) for row in scene.rows)
        robots = len(run.robots)
        most = 2.0 * (robots - 1) / robots * strongest * (1.0 + 1e-5)
        self.add_bounded("internal_force_n", 0.0, most, "what is left of forces less their mean")
        held = slice(0, last if dropped and has_end else last + 1)
        slip, turn = (float(np.max(part[held], initial=0.0)) for part in scene.find_slip(robot))
        limit = carrying.WELD_M if rules.max_slip_m is None else rules.max_slip_m
        turn_limit = carrying.WELD_RAD if rules.max_slip_m is None else float("inf")
        stays = slip <= limit and turn <= turn_limit
        self._add_finding(
            "grip",
            "exact",
            "agrees" if stays else "disagrees",
            stored=None,
            judged=slip,
            deviation=slip,
            tolerance=limit,
            note="" if stays else f"turned by {turn:.3g} rad in its grip",
        )

    def add_no_contact(self, how: CheckMethod) -> None:
        """Add the absence of a collision: no pair and no speed."""
        pair, speed = self.row["failure_pair"], float(self.row["impact_speed_mps"])
        fits: FindingResult = "agrees" if pair == "none" else "disagrees"
        self._add_finding("failure_pair", how, fits, stored=pair, judged="none")
        fits = "agrees" if np.isnan(speed) else "disagrees"
        self._add_finding("impact_speed_mps", how, fits, stored=speed, judged=None)

    def set_position(self, outcome: str, p: Floats) -> None:
        """Add the end position; it is not stored for robots that arrived."""
        stored = np.array([float(self.row[name]) for name in POSITION_COLUMNS])
        if outcome == "reached":
            fits = bool(np.isnan(stored).all())
            apart = 0.0 if fits else float("inf")
        else:
            apart = float(np.linalg.norm(stored - p))
            fits = apart == 0.0
        self._add_finding(
            "failure_place_m",
            "exact",
            "agrees" if fits else "disagrees",
            stored=_format_point(stored),
            judged=None if outcome == "reached" else _format_point(p),
            deviation=apart if np.isfinite(apart) else float("inf"),
        )

    def task(self) -> None:
        """Add the progress of the world's task, and whether the stored task data are possible."""
        scene, judged = self._scene, self._scene.task
        if scene.run.task is None:
            return
        if judged is None:
            for name in TASK_QUANTITIES:
                self.unchecked(name, "no sample shows every look at the task")
            return
        how: CheckMethod = "bounded" if judged.is_bounded else "exact"
        completed_s = judged.completed_step * scene.run.control_dt_s
        if judged.completed_step == NEVER:
            completed_s = np.nan
        rounding = TIME_ULPS * float(np.spacing(np.float32(max(np.nan_to_num(completed_s), 1.0))))
        self._add_task_number("jobs_done", how, float(judged.jobs_done[self._robot]), 0.0)
        self._add_task_number("task_progress", "exact", judged.progress, PROGRESS_TOLERANCE)
        self._add_task_number("task_completed_s", "exact", completed_s, rounding)
        faults = judged.faults if self._robot == 0 else []
        result: FindingResult = "agrees"
        if faults:
            result = "undecided" if judged.doubt else "disagrees"
        note = "; ".join([*faults, *([judged.doubt] if faults and judged.doubt else [])])
        self._add_finding("task", how, result, stored=None, judged=None, note=note)

    def _add_task_number(
        self, quantity: str, how: CheckMethod, judged: float, tolerance: float
    ) -> None:
        """Add a number of a task; a difference that rounding can explain is undecided."""
        stored, scene = float(self.row[quantity]), self._scene
        doubt = scene.task.doubt if scene.task is not None else ""
        is_same = stored == judged or (np.isnan(stored) and np.isnan(judged))
        difference = 0.0 if is_same else abs(stored - judged)
        result: FindingResult = "agrees"
        if not difference <= tolerance:
            result = "undecided" if doubt else "disagrees"
        self._add_finding(
            quantity,
            how,
            result,
            stored=stored,
            judged=judged,
            deviation=float(difference) if np.isfinite(difference) else float("inf"),
            tolerance=tolerance,
            note="" if result == "agrees" else doubt,
        )

    def record(self, end: int) -> None:
        """Add whether the trajectory is possible: start, outcomes, and rest after a failure."""
        faults = self._faults(end)
        result: FindingResult = "disagrees" if faults else "agrees"
        text = "; ".join(faults)
        self._add_finding("record", "exact", result, stored=text or None, judged=None, note="")

    def _faults(self, end: int) -> list[str]:
        """Return the faults of the trajectory; ``end`` is the state that ended the episode."""
        world, robot, faults = self._scene.world, self._robot, []
        start_m = np.float32(world.environment["start_m"][robot])  # as states are stored
        if not np.array_equal(np.float32(world.p[0, robot]), start_m):
            faults.append("it does not begin at the world's start")
        if world.nu[0, robot].any():
            faults.append("it does not begin at rest")
        name = self._scene.stored_outcome(robot)
        number = OUTCOMES.index(name) if name in OUTCOMES and name != "timeout" else 0
        expected = np.where(np.arange(len(world.step)) >= end, number, 0)
        wrong = np.flatnonzero(world.outcome[:, robot] != expected)
        if wrong.size:
            state = int(wrong[0])
            faults.append(
                f"beside the state after {world.step[state]} steps stands "
                f"{_format_outcome(world.outcome[state, robot])}, not "
                f"{_format_outcome(expected[state])}"
            )
        if (
            name in FAILED
            and end < len(world.step)
            and (
                np.any(world.p[end:, robot] != world.p[end, robot])
                or np.any(world.q[end:, robot] != world.q[end, robot])
                or world.nu[end + 1 :, robot].any()
            )
        ):
            faults.append("it moves after its episode has failed")
        faults += self._early_faults(end)
        arm, joints = self._scene.run.robots[robot].hull.arm, world.joints
        if arm is not None and joints is not None and (excess := arm.find_excess(joints[:, robot])):
            faults.append(excess)
        vehicle = self._scene.run.robots[robot]
        if self.row["vehicle"] not in vehicle.names:
            faults.append(f"it is called {self.row['vehicle']}, not {vehicle.names[0]}")
        if self.row["parameter_set"] not in vehicle.parameter_sets:
            faults.append(f"its fleet has no set {self.row['parameter_set']}")
        return faults

    def _early_faults(self, end: int) -> list[str]:
        """Return the faults of `passed_goal_early`; ``end`` is the state of the end."""
        scene, is_early = self._scene, self.row["passed_goal_early"]
        if not is_early or scene.run.by_task or scene.run.every > 1:
            return []
        to_goal_m = scene.to_goal_m[1 : end + 1, self._robot]
        if np.any(to_goal_m < scene.position_band_m):
            return []
        return ["it was never at its goal, and passed_goal_early is true"]


def _format_outcome(number: int) -> str:
    return OUTCOMES[number] if 0 <= number < len(OUTCOMES) else str(number)


def _format_point(p: Floats) -> str:
    return f"({', '.join(f'{x:.7g}' for x in p)})"
