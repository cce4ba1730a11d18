"""Orders of each robot of a session, and their status."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import DTypeLike

from angler_mjx.robot.control.commands.joint_goal import JointGoal
from angler_mjx.robot.control.commands.joint_tolerance import ResultCode
from angler_mjx.robot.control.commands.joint_trajectory import JointTrajectory
from angler_mjx.robot.control.commands.whole_body import JointTarget, WholeBodyCommand
from angler_mjx.robot.control.plans import check_plan
from angler_mjx.robot.control.stack import Command, Stages
from angler_mjx.runs.session import command_preparation
from angler_mjx.runs.session.command_slots import CommandSlots, SlotSizes
from angler_mjx.runs.session.command_validation import CommandLimits
from angler_mjx.runs.session.fleet_facts import FleetFacts
from angler_mjx.runs.session.interface import RobotStatus, SessionCommand
from angler_mjx.runs.session.robot_plan import RobotPlan
from angler_mjx.runs.session.state_view import StateView
from angler_mjx.sim.state import Outcome

PLAN_COMMAND = "plan"
"""Command of a robot without orders."""


@dataclass(kw_only=True)
class CommandState:
    """Order of one robot, and its status."""

    plan: RobotPlan
    """Last plan."""
    command: str = PLAN_COMMAND
    plan_time_s: float = 0.0
    """Progress along the plan when another order came."""
    refused: str = ""
    note: str = ""
    result: ResultCode = ResultCode.SUCCESSFUL
    """Result of its JointTrajectory; ACTIVE while it follows one."""
    pending: JointGoal | None = None
    """Order with a later start."""


class CommandQueue:
    """Queue of checked orders for robots, and refusals.

    Attributes:
        slots: commands of the controllers.
    """

    def __init__(
        self, stages: Stages, facts: FleetFacts, limits: CommandLimits, dtype: DTypeLike
    ) -> None:
        """Give every robot its plan.

        Raises:
            ConfigError: the controllers do not take plans of its type.
        """
        self._stages, self._limits, self._dtype = stages, limits, dtype
        self.slots = CommandSlots(
            stages,
            SlotSizes(
                robots=len(facts.robots),
                thrusters=facts.thrusters,
                points=limits.points,
                way_points=limits.way_points,
                joints=facts.joints,
            ),
        )
        self._joints = facts.joints
        self._states = [CommandState(plan=plan) for plan in facts.plans]
        for robot, plan in enumerate(facts.plans):
            self.resume(robot, plan)
            if not facts.found[robot]:
                self._states[robot].note = "the planner found no way: it holds its start"

    def __getitem__(self, robot: int) -> CommandState:
        """Return the order of a robot."""
        return self._states[robot]

    @property
    def results(self) -> np.ndarray:
        """Return the results of JointTrajectories, int32 [R]."""
        return np.array([state.result for state in self._states], np.int32)

    def status(self, outcomes: Sequence[int]) -> tuple[RobotStatus, ...]:
        """Return the status of the robots, for an observation."""
        return tuple(
            RobotStatus(
                outcome=Outcome(int(outcome)),
                command=state.command,
                refused=state.refused,
                note=state.note,
            )
            for state, outcome in zip(self._states, outcomes, strict=True)
        )

    def due(self, now_s: float) -> dict[int, SessionCommand]:
        """Return the JointTrajectories that are due."""
        return {
            robot: state.pending
            for robot, state in enumerate(self._states)
            if state.pending is not None and state.pending.stamp_s <= now_s
        }

    def give_command(
        self, robot: int, order: SessionCommand, view: StateView, now_s: float
    ) -> None:
        """Give a robot an order that was checked."""
        if isinstance(order, JointGoal) and order.stamp_s > now_s:
            state = self._states[robot]
            state.pending, state.refused = order, ""
            state.note = f"a JointTrajectory begins at {order.stamp_s:g} s"
            return
        command = command_preparation.prepare_command(
            self.slots, view, robot, order, self._limits, now_s
        )
        if isinstance(command, JointTarget):
            self.slots.put(robot, command)
            self._states[robot].refused = ""
            return
        self._put_command(robot, command, type(command).__name__, view)
        base = command.base if isinstance(command, WholeBodyCommand) else command
        if isinstance(base, JointTrajectory):
            state = self._states[robot]
            state.result, state.note = ResultCode.ACTIVE, ResultCode.ACTIVE.name

    def refuse(self, robot: int, reason: str, view: StateView) -> None:
        """Refuse a robot's order: it holds position, that of the first refusal if refused again."""
        if not self._states[robot].refused:
            self._hold_position(robot, view)
        self._states[robot].refused = reason

    def resume(self, robot: int, plan: RobotPlan) -> None:
        """Let a robot follow its plan from the plan's beginning."""
        self._states[robot] = CommandState(plan=plan)
        padded_plan = plan.padded(self._limits.rows(plan.kind), self._dtype)
        self.slots.put(robot, check_plan(self._stages, padded_plan, self._joints))

    def report(self, view: StateView) -> None:
        """Update the results of JointTrajectories; a failed one ends at the robot's position."""
        for robot, state in enumerate(self._states):
            if state.result is not ResultCode.ACTIVE:
                continue
            code = ResultCode(int(view.result[robot]))
            state.result, note = code, code.name
            if code in (ResultCode.PATH_TOLERANCE_VIOLATED, ResultCode.GOAL_TOLERANCE_VIOLATED):
                joint = command_preparation.describe_farthest_joint(self.slots, view, robot)
                note = f"{code.name}: {joint}; holding position"
                self._hold_position(robot, view)
            self._states[robot].note = note

    def _hold_position(self, robot: int, view: StateView) -> None:
        command = command_preparation.hold_command(self.slots.kinds, view, robot, self._limits)
        self._put_command(robot, command, "hold", view)

    def _put_command(self, robot: int, command: Command, name: str, view: StateView) -> None:
        """Give a robot another command."""
        state = self._states[robot]
        plan_time_s = state.plan_time_s
        if state.command == PLAN_COMMAND:
            plan_time_s = command_preparation.plan_progress_s(self._stages, state.plan, view, robot)
        self._states[robot] = CommandState(plan=state.plan, command=name, plan_time_s=plan_time_s)
        self.slots.put(robot, command)
