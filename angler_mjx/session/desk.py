"""What each robot of a session was told, and how it stands with that."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from angler_mjx.control.joint_goal import JointGoal
from angler_mjx.control.joint_tolerance import ResultCode
from angler_mjx.control.joint_trajectory import JointTrajectory
from angler_mjx.control.stack import Stages
from angler_mjx.session import paths
from angler_mjx.session.board import Board, Sizes
from angler_mjx.session.checks import Limits
from angler_mjx.session.fleet_facts import Facts
from angler_mjx.session.interface import Order, RobotStatus
from angler_mjx.session.rejoin import Plan
from angler_mjx.session.view import View
from angler_mjx.sim.state import Outcome

PLAN = "plan"
"""What a robot follows that was told nothing else."""


@dataclass(kw_only=True)
class Told:
    """What one robot was told."""

    plan: Plan
    """As it was told it last."""
    command: str = PLAN
    left_s: float = 0.0
    """How far along its plan it was when it was told something else."""
    refused: str = ""
    note: str = ""
    result: ResultCode = ResultCode.SUCCESSFUL
    """Of its JointTrajectory; ACTIVE while it follows one."""
    waiting: JointGoal | None = None
    """One that begins later."""


class Desk:
    """Takes checked orders for robots, and refusals.

    Attributes:
        board: what the controllers are told.
    """

    def __init__(self, stages: Stages, facts: Facts, limits: Limits, dtype: Any) -> None:
        """Every robot is told its plan."""
        self._stages, self._limits, self._dtype = stages, limits, dtype
        self.board = Board(
            stages,
            Sizes(
                robots=len(facts.robots),
                thrusters=facts.thrusters,
                points=limits.points,
                way_points=limits.way_points,
            ),
        )
        self._told = [Told(plan=plan) for plan in facts.plans]
        for robot, plan in enumerate(facts.plans):
            self.resume(robot, plan)
            if not facts.found[robot]:
                self._told[robot].note = "the planner found no way: it holds its start"

    def __getitem__(self, robot: int) -> Told:
        """What a robot was told."""
        return self._told[robot]

    @property
    def results(self) -> np.ndarray:
        """int32 [R] how JointTrajectories stand."""
        return np.array([told.result for told in self._told], np.int32)

    def status(self, outcomes: Sequence[Any]) -> tuple[RobotStatus, ...]:
        """For an observation."""
        return tuple(
            RobotStatus(
                outcome=Outcome(int(outcome)),
                command=told.command,
                refused=told.refused,
                note=told.note,
            )
            for told, outcome in zip(self._told, outcomes, strict=True)
        )

    def due(self, now_s: float) -> dict[int, Order]:
        """JointTrajectories that waited for this time."""
        return {
            robot: told.waiting
            for robot, told in enumerate(self._told)
            if told.waiting is not None and told.waiting.stamp_s <= now_s
        }

    def tell(self, robot: int, order: Order, view: View, now_s: float) -> None:
        """Give a robot an order that was checked."""
        if isinstance(order, JointGoal) and order.stamp_s > now_s:
            told = self._told[robot]
            told.waiting, told.refused = order, ""
            told.note = f"a JointTrajectory begins at {order.stamp_s:g} s"
            return
        command = paths.ready(self.board, view, robot, order, self._limits, now_s)
        self._put(robot, command, type(command).__name__, view)
        if isinstance(command, JointTrajectory):
            told = self._told[robot]
            told.result, told.note = ResultCode.ACTIVE, ResultCode.ACTIVE.name

    def refuse(self, robot: int, reason: str, view: View) -> None:
        """Refuse a robot's order: it holds; refused again, where it was refused first."""
        if not self._told[robot].refused:
            self._hold(robot, view)
        self._told[robot].refused = reason

    def resume(self, robot: int, plan: Plan) -> None:
        """Let a robot follow its plan from its beginning."""
        self._told[robot] = Told(plan=plan)
        self.board.put(robot, plan.padded(self._limits.way_points, self._dtype))

    def report(self, view: View) -> None:
        """Say how JointTrajectories stand; one that failed ends where the robot is."""
        for robot, told in enumerate(self._told):
            if told.result is not ResultCode.ACTIVE:
                continue
            code = ResultCode(int(view.result[robot]))
            told.result, note = code, code.name
            if code in (ResultCode.PATH_TOLERANCE_VIOLATED, ResultCode.GOAL_TOLERANCE_VIOLATED):
                note = f"{code.name}: {paths.farthest(self.board, view, robot)}; it holds here"
                self._hold(robot, view)
            self._told[robot].note = note

    def _hold(self, robot: int, view: View) -> None:
        command = paths.hold(self.board.kinds, view, robot, self._limits)
        self._put(robot, command, "hold", view)

    def _put(self, robot: int, command: Any, name: str, view: View) -> None:
        """Tell a robot something else than what it had."""
        told = self._told[robot]
        left = told.left_s
        if told.command == PLAN:
            left = paths.along(self._stages, told.plan, view, robot)
        self._told[robot] = Told(plan=told.plan, command=name, left_s=left)
        self.board.put(robot, command)
