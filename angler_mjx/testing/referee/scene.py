"""One world for the referee: margin of each state to the end of each robot's episode."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from angler_mjx.testing.referee import approach, carrying, contacts, teamwork
from angler_mjx.testing.referee.contacts import (
    CELL,
    FLOOR,
    OBSTACLE,
    ContactPairs,
    Ints,
    NearbyPairs,
)
from angler_mjx.testing.referee.folder import Row
from angler_mjx.testing.referee.geometry import Floats, rotate
from angler_mjx.testing.referee.record import RefereeRun, RefereeWorld

MAX_SPEED_SUM = 50.0
"""Sum of a robot's six velocities at which it has diverged."""

CONTACT_ULPS, POSITION_ULPS = 4.0, 2.0
"""Rounding of a distance between hulls, and of one between points, in units of the last place of
the largest coordinate in float32."""

FAILED = (
    "collision_static",
    "collision_dynamic",
    "collision_robot",
    "out_of_bounds",
    "diverged",
    "failed",
    "damaged",
    "dropped",
)
"""Outcomes that hold a robot in place."""


@dataclass(frozen=True, kw_only=True)
class RefereeScene:
    """World with the record of its robots' episodes, and the quantities from its trajectories."""

    run: RefereeRun
    world: RefereeWorld
    rows: Sequence[Row]

    @cached_property
    def ulp_m(self) -> float:
        """Unit of the last place of the largest coordinate in float32."""
        corners = np.abs([*self.world.low_m, *self.world.high_m])
        return float(np.spacing(np.float32(max(1.0, corners.max()))))

    @property
    def contact_band_m(self) -> float:
        """Band around zero in which a gap is neither a certain touch nor a certain miss."""
        return CONTACT_ULPS * self.ulp_m

    @property
    def position_band_m(self) -> float:
        """Same band of distances to the goal and to the bounds."""
        return POSITION_ULPS * self.ulp_m

    @cached_property
    def to_goal_m(self) -> Floats:
        """[T, R] distance to the goal less the tolerance: arrived below zero.

        For a run with a task -inf as soon as nothing is left for a robot, else inf. Where robots
        hold a body it is that of the body, or its angle less the tolerance in rad.
        """
        if self.run.carry is not None:
            margin = carrying.find_margin(self.run.carry, self.cargo, self.run.every)
            holds = np.arange(len(margin))[:, None] >= self.gripped
            return np.where(holds, margin[:, None], np.inf)
        if self.run.by_task:
            finished = np.full(self.world.p.shape[1], teamwork.NEVER)
            if self.task is not None and self.shows_finish:
                finished = self.task.finished_step
            return np.where(self.world.step[:, None] >= finished, -np.inf, np.inf)
        goal = np.asarray(self.world.environment["goal_m"], float)
        arriving_m = self._end_effectors_m() if self.run.by_end_effector else self.world.p
        gap: Floats = np.linalg.norm(arriving_m - goal, axis=2) - self.run.goal_tolerance_m
        return gap

    @cached_property
    def cargo(self) -> carrying.CargoRecord:
        """Record of the body that the robots hold together."""
        rules = self.run.carry
        if rules is None:
            raise ValueError("the robots hold nothing")
        p, q = self.world.obstacle_p[:, rules.body], self.world.obstacle_q[:, rules.body]
        return carrying.CargoRecord(p=p, q=q)

    @cached_property
    def gripped(self) -> Ints:
        """[R] first state in which each robot holds the body; T if it never does."""
        rules, states = self.run.carry, len(self.world.step)
        if rules is None or not rules.is_gripped_in_flight:
            return np.zeros(len(self.rows), np.int64)
        times = np.array([float(row["gripped_s"]) for row in self.rows])
        steps = np.where(np.isfinite(times), np.rint(times / self.run.control_dt_s), 2**31)
        first: Ints = np.minimum(np.searchsorted(self.world.step, steps), states)
        return first

    def find_slip(self, robot: int) -> tuple[Floats, Floats]:
        """Return how far [T] m and rad the body is from where a robot took hold of it."""
        rules = self.run.carry
        first = int(self.gripped[robot])
        if rules is None or not rules.by_end_effector:
            p, q = self.world.p[:, robot], self.world.q[:, robot]
            return carrying.find_slip(self.cargo, p, q, first)
        return carrying.find_slip(self.cargo, self._end_effectors_m()[:, robot], None, first)

    def _end_effectors_m(self) -> Floats:
        """Return the end effectors [T, R, 3] of the robots; NaN without joints or without one."""
        position_m = np.full_like(self.world.p, np.nan)
        joints = self.world.joints
        for robot, (vehicle, _) in enumerate(zip(self.run.robots, self.rows, strict=True)):
            arm = vehicle.hull.arm
            if arm is None or joints is None or arm.end_link < 0:
                continue
            tip_m = arm.locate_end_effector(joints[:, robot])
            position_m[:, robot] = self.world.p[:, robot] + rotate(self.world.q[:, robot], tip_m)
        return position_m

    @cached_property
    def task(self) -> teamwork.JudgedTask | None:
        """Judged task; None without a task, or where the samples do not show each look."""
        rules, world = self.run.task, self.world
        if rules is None or rules.period % self.run.every:
            return None
        looks = slice(0, len(world.pwm_us), rules.period // self.run.every)
        return teamwork.judge_task(
            rules,
            teamwork.TaskRecord(
                step=world.step[: len(world.pwm_us)][looks],
                dt_s=self.run.control_dt_s,
                p=world.p[: len(world.pwm_us)][looks],
                q=world.q[: len(world.pwm_us)][looks],
                running=world.outcome[: len(world.pwm_us)][looks] == 0,
                target=world.target[looks],
                carrying=world.carrying[looks],
                environment=world.environment,
                low_m=world.low_m,
                band_m=self.position_band_m,
            ),
        )

    @property
    def shows_finish(self) -> bool:
        """Whether the record shows the time at which a robot has nothing left to do."""
        rules, judged = self.run.task, self.task
        if self.run.carry is not None:
            return self.run.every == 1 or self.run.carry.hold_steps == 1
        return (
            rules is not None
            and rules.is_fully_informed
            and judged is not None
            and not judged.doubt
        )

    @cached_property
    def arrives(self) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Bool [T, R] twice: whether a robot at its goal may have arrived, and whether it has.

        They differ where the record does not determine its progress along its plan.
        """
        may = np.ones(self.world.p.shape[:2], bool)
        must = may.copy()
        if self.run.carry is not None:
            must[:] = self.shows_finish
            return may, must
        for robot, row in enumerate(self.rows):
            if row["passed_goal_early"] is None:  # of an older version
                continue
            must[:, robot] = not row["passed_goal_early"]
            if self.run.has_flown_plans and row.get("planned", True):
                self._approach(robot, may[:, robot], must[:, robot])
        return may, must

    def _approach(self, robot: int, may: NDArray[np.bool_], must: NDArray[np.bool_]) -> None:
        """Write `arrives` of a robot on its stored plan, [T] each, where the plan shows it."""
        environment, tolerance_m = self.world.environment, self.run.goal_tolerance_m
        if "plan_degree" in environment and np.any(
            np.asarray(environment["plan_degree"][robot]) > 1
        ):
            return  # it is bent: aims do not determine the time on it
        time_s = np.asarray(environment["plan_time_s"][robot], float)
        point_m = np.asarray(environment["plan_m"][robot], float)
        goal_m = np.asarray(environment["goal_m"][robot], float)
        begin_s = approach.last_approach_s(time_s, point_m, goal_m, tolerance_m)
        within_m = tolerance_m + approach.APPROACH_M
        passes = approach.passes_before(time_s, point_m, goal_m, within_m, begin_s)
        if must.all() and not passes:
            return
        spans_s = np.diff(self.world.step, prepend=0) * self.run.control_dt_s
        aim_m = np.asarray(environment["target_m"], float)[: len(spans_s), robot]
        aim_m = aim_m[np.isfinite(aim_m).all(axis=1)]
        bounds = approach.progress_s(time_s, point_m, aim_m, spans_s)
        if bounds is not None:
            low_s, high_s = bounds
            may[:], must[:] = high_s >= begin_s - 1e-6, low_s >= begin_s

    @cached_property
    def outside_m(self) -> Floats:
        """[T, R] distance outside the region: left it above zero."""
        p, world = self.world.p, self.world
        beyond: Floats = np.max(np.maximum(world.low_m - p, p - world.high_m), axis=2)
        return beyond

    @cached_property
    def sound(self) -> NDArray[np.bool_]:
        """Bool [T, R] whether a state is valid."""
        speed = np.sum(np.abs(self.world.nu), axis=2)
        is_finite = np.isfinite(self.world.p).all(axis=2) & np.isfinite(self.world.q).all(axis=2)
        is_sound: NDArray[np.bool_] = is_finite & (speed < MAX_SPEED_SUM)
        return is_sound

    @cached_property
    def ended(self) -> Ints:
        """[R] first state at which the record has a robot's episode ended; T if none."""
        over = self.world.outcome > 0
        return np.where(over.any(axis=0), over.argmax(axis=0), len(self.world.step))

    @cached_property
    def stored_step(self) -> list[int | None]:
        """[R] control steps until each robot's end, by the results; None if they are missing."""
        return [self._stored_steps(row) for row in self.rows]

    def stored_end_s(self, robot: int) -> float:
        """Return the end time of a robot's episode, by the results."""
        row = self.rows[robot]
        reached = row["outcome"] == "reached"
        return float(row["time_to_goal_s" if reached else "failure_time_s"])

    def stored_outcome(self, robot: int) -> str:
        """Return the outcome of the results."""
        return str(self.rows[robot]["outcome"])

    def _stored_steps(self, row: Row) -> int | None:
        time = float(row["time_to_goal_s" if row["outcome"] == "reached" else "failure_time_s"])
        steps = time / self.run.control_dt_s
        return round(steps) if np.isfinite(steps) and abs(steps) < 2**31 else None

    def unseen(self, step: int) -> set[str]:
        """Return the outcomes possible after these control steps but not shown in the record."""
        outcomes = {"reached"} if self.run.by_task and not self.shows_finish else set[str]()
        if self.run.damage_energy_j is not None:
            outcomes.add("damaged")
        if self.run.carry is not None and self.run.carry.can_drop:
            outcomes.add("dropped")
        if self.run.breakdowns_s is not None:
            earliest, latest = self.run.breakdowns_s
            end_s, slack = step * self.run.control_dt_s, 1e-6 * max(1.0, latest)
            if earliest - slack <= end_s < latest + self.run.control_dt_s + slack:
                outcomes.add("failed")
        return outcomes

    def state_at(self, step: int | None) -> int | None:
        """Return the state after a number of control steps, if it is in the record."""
        if step is None:
            return None
        state = int(np.searchsorted(self.world.step, step))
        is_stored = state < len(self.world.step) and self.world.step[state] == step
        return state if is_stored else None

    @cached_property
    def last(self) -> Ints:
        """[R] last relevant state of each robot: the latest end by the results or the record.

        Later states are not part of its episode. Robots that certainly arrived or left before are
        not followed further.
        """
        final = len(self.world.step) - 1
        named = np.minimum(self.ended, final)
        for robot, step in enumerate(self.stored_step):
            after = 0 if step is None else int(np.searchsorted(self.world.step, step))
            named[robot] = min(max(named[robot], after), final)
        arrived = (self.to_goal_m < -self.position_band_m) & self.arrives[1]
        over = arrived | (self.outside_m > self.position_band_m)
        over[0] = False
        return np.where(over.any(axis=0), np.minimum(named, over.argmax(axis=0)), named)

    @cached_property
    def near(self) -> NearbyPairs:
        """Nearby pairs of the robots."""
        hulls = tuple(robot.hull for robot in self.run.robots)
        return contacts.find_nearby(self.world, hulls, self.last, 2.0 * self.contact_band_m)

    def near_until(self, robot: int, state: int) -> NearbyPairs:
        """Return the nearby pairs of a robot in the states up to a given one."""
        if state == self.last[robot]:
            return self.near
        last = np.full(len(self.run.robots), -1, np.int64)
        last[robot] = state
        hulls = tuple(item.hull for item in self.run.robots)
        return contacts.find_nearby(self.world, hulls, last, 0.0)

    @cached_property
    def path_m(self) -> Floats:
        """[T, R] sum of the straight lines from state to state."""
        lines = np.linalg.norm(np.diff(self.world.p, axis=0), axis=2)
        return np.concatenate([np.zeros((1, lines.shape[1])), np.cumsum(lines, axis=0)])

    def velocity(self, state: int, robot: int) -> Floats:
        """Return the velocity [3] of a robot's centre, m/s in W."""
        return rotate(self.world.q[state, robot], self.world.nu[state, robot, :3])

    def name(self, kind: int, index: int) -> str:
        """Return the name of a collision partner, as in the results."""
        return {CELL: "cell", FLOOR: "floor"}.get(
            kind, f"{'obstacle' if kind == OBSTACLE else 'robot'}:{index}"
        )

    def collision(self, kind: int, index: int) -> str:
        """Return the outcome of touching an object."""
        if kind == contacts.ROBOT:
            return "collision_robot"
        moving = (
            kind == OBSTACLE and self.world.environment["obstacles/motion"][index] != contacts.STILL
        )
        return "collision_dynamic" if moving else "collision_static"


class RefereeEpisode:
    """Episode of one robot of a scene: outcomes allowed by each of its states."""

    def __init__(self, scene: RefereeScene, robot: int) -> None:
        self._scene, self.robot = scene, robot
        self._pairs = scene.near.of(robot)
        self._min_gap_m = np.full(len(scene.world.step), np.inf)
        np.minimum.at(self._min_gap_m, self._pairs.state, self._pairs.gap_m)
        goal, out = scene.to_goal_m[:, robot], scene.outside_m[:, robot]
        self._may, self._must = (of_all[:, robot] for of_all in scene.arrives)
        arrived = (goal < 0.0) & self._must
        touches = (self._min_gap_m <= 0.0) & (not scene.run.has_contacts)
        self._over = ~scene.sound[:, robot] | touches | (out > 0.0) | arrived

    def first(self, last: int) -> int | None:
        """Return the first state after the start, up to ``last``, that ends the episode."""
        over = np.flatnonzero(self._over[1 : last + 1])
        return int(over[0]) + 1 if over.size else None

    def touched_pairs(self, state: int, within_m: float = 0.0) -> ContactPairs:
        """Return the touched objects of a state, nearest first, up to this far from the nearest."""
        pairs = self._pairs.take(self._pairs.state == state)
        pairs = pairs.take(pairs.gap_m <= self._min_gap_m[state] + within_m)
        return pairs.take(np.lexsort((pairs.index, pairs.kind, pairs.gap_m)))

    def static_gap_m(self, state: int) -> float:
        """Return the min distance in a state to cells, floor and obstacles that never move."""
        nearby = self._pairs.take(self._pairs.state == state)
        pairs = zip(nearby.kind.tolist(), nearby.index.tolist(), nearby.gap_m.tolist(), strict=True)
        static_gaps = (
            gap for k, i, gap in pairs if self._scene.collision(k, i) == "collision_static"
        )
        return min(static_gaps, default=float("inf"))

    def outcome(self, state: int) -> str:
        """Return the outcome of a state, with all numbers taken as they are."""
        scene = self._scene
        if not scene.sound[state, self.robot]:
            return "diverged"
        if self._min_gap_m[state] <= 0.0 and not scene.run.has_contacts:
            nearest = self.touched_pairs(state)
            return scene.collision(int(nearest.kind[0]), int(nearest.index[0]))
        if scene.outside_m[state, self.robot] > 0.0:
            return "out_of_bounds"
        arrived = scene.to_goal_m[state, self.robot] < 0.0 and self._may[state]
        return "reached" if arrived else "running"

    def possible_outcomes(self, state: int) -> set[str]:
        """Return the possible outcomes of a state under rounding."""
        scene, outcomes = self._scene, set[str]()
        if not scene.sound[state, self.robot]:
            return {"diverged"}
        gap, band = self._min_gap_m[state], scene.contact_band_m
        gap = np.inf if scene.run.has_contacts else gap
        if gap <= band:
            nearby = self.touched_pairs(state, 2.0 * band)
            pairs = zip(nearby.kind.tolist(), nearby.index.tolist(), strict=True)
            outcomes |= {scene.collision(kind, index) for kind, index in pairs}
        if gap < -band:
            return outcomes
        out, goal, band = (
            scene.outside_m[state, self.robot],
            scene.to_goal_m[state, self.robot],
            scene.position_band_m,
        )
        if out > -band:
            outcomes.add("out_of_bounds")
        if out > band:
            return outcomes
        if goal < band and self._may[state]:
            outcomes.add("reached")
        arrived = goal < -band and self._must[state]
        return outcomes if arrived else outcomes | {"running"}

    def numbers(self, state: int) -> str:
        """Return the numbers that decided about a state, as text."""
        scene = self._scene
        return (
            f"at {scene.world.step[state] * scene.run.control_dt_s:.6g} s the nearest thing is "
            f"{self._min_gap_m[state]:.3g} m away, the bounds "
            f"{-scene.outside_m[state, self.robot]:.3g}"
            f" m, the goal {scene.to_goal_m[state, self.robot]:.3g} m beyond its tolerance"
        )
