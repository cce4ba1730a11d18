"""Base of sessions over autopilots: commands, checks and observations, whatever the autopilots are.

A subclass brings the autopilots up in its ``reset`` and advances them in ``_advance_period``.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import replace

import jax
import numpy as np

from angler_mjx.errors import ConfigError, RunError
from angler_mjx.robot.control.commands import PoseTarget
from angler_mjx.robot.control.commands.joint_tolerance import Tolerances
from angler_mjx.runs.session import (
    command_preparation,
    command_validation,
    fleet_facts,
    robot_checks,
)
from angler_mjx.runs.session.batch_session import SessionInternals
from angler_mjx.runs.session.command_queue import PLAN_COMMAND, CommandQueue
from angler_mjx.runs.session.command_validation import CommandLimits, RobotPosition
from angler_mjx.runs.session.fleet_facts import FleetFacts
from angler_mjx.runs.session.interface import (
    Observation,
    RobotInfo,
    RobotStatus,
    SessionCommand,
)
from angler_mjx.runs.session.rejoin import RejoinPaths
from angler_mjx.scenario.scenario import Scenario
from angler_sitl.autopilots.session_view import SessionView, SteeredAutopilots
from angler_sitl.firmware.parameters import CommandLevel
from angler_sitl.scene.scene import AutopilotScene
from angler_sitl.steering import levels
from angler_sitl.steering.command_sender import CommandSender
from angler_sitl.steering.levels import STICK_LEVELS


class AutopilotSession[A: SteeredAutopilots](ABC):
    """`Session` over one world of a scenario, steered by autopilots of one type."""

    def __init__(
        self,
        scenario: Scenario,
        scene: AutopilotScene,
        sender: CommandSender,
        *,
        level: CommandLevel,
        points: int,
        start_tolerance: float,
        tolerances: Tolerances | None,
        use_truth: bool,
    ) -> None:
        """Take over a compiled scene; nothing is observed before the reset.

        Args:
            scenario: the scenario.
            scene: of one of its worlds.
            sender: of the commands, at that level.
            level: where commands enter.
            points: max number of points of a JointTrajectory.
            start_tolerance: max distance from a robot to the start of a path, m and rad.
            tolerances: of JointTrajectories; those of `paths` if left out.
            use_truth: whether controllers and checks receive the truth of the scene.
        """
        self._scenario, self._scene, self._command_sender = scenario, scene, sender
        self._simulator, self._spec = scene.simulator, sender.spec
        self._level, self._uses_truth = level, use_truth
        self._tolerances = command_preparation.stack_tolerances(tolerances, scenario)
        self._points, self._start_tolerance = points, start_tolerance
        self._autopilots: A | None = None
        self._closed, self._steps = False, 0
        self._facts: FleetFacts

    @property
    def robots(self) -> Sequence[RobotInfo]:
        """Robots of the scene, in order."""
        return self._facts.robots

    @property
    def dt_s(self) -> float:
        """Control period, s."""
        return self._spec.control_dt_s

    def inside(self) -> SessionInternals:
        """Return the internals of the scene, for recordings; read-only."""
        self._require_open()
        state, memory = self._scene.state, self._command_sender.memory
        carry = replace(state.carry, joints=memory.joints, joints_clipped=memory.joints_clipped)
        return SessionInternals(
            simulator=self._simulator,
            worlds=self._scene.worlds,
            state=replace(state, carry=carry),
            sample=self._view.sample,
        )

    def step(self, commands: Mapping[int, SessionCommand] | None = None) -> Observation:
        """Step as `Session.step`."""
        self._require_open()
        for robot in commands or {}:
            robot_checks.require_robot(self.robots, robot)
        # Half a period: times are sums in floating point.
        due_time_s = self._time_s + 0.5 * self.dt_s
        for robot, command in {**self._command_queue.due(due_time_s), **(commands or {})}.items():
            try:
                self.check(robot, command)
            except ConfigError as error:
                self._command_queue.refuse(robot, str(error), self._view.estimated_view)
            else:
                self._command_queue.give_command(
                    robot, command, self._view.estimated_view, due_time_s
                )
        try:
            self._advance_period()
        except BaseException:
            self._stop_autopilots()
            raise
        self._view.update(self.autopilots, self._command_queue, self._command_sender)
        self._command_queue.report(self._view.estimated_view)
        return self.observe()

    def observe(self) -> Observation:
        """Observe as `Session.observe`."""
        self._require_open()
        return self._view.make_observation(self._time_s, self._collect_status())

    def check(self, robot: int, command: SessionCommand) -> None:
        """Check a command as `Session.check`."""
        self._require_drivable(robot)
        info, view = self.robots[robot], self._view.estimated_view
        arm = view.arm_position(robot)
        position = RobotPosition(
            p=np.asarray(view.p[robot], float),
            yaw_rad=float(view.yaw_rad[robot]),
            arm=() if arm is None else tuple(arm.tolist()),
        )
        command_validation.check_command(info, position, self._limits, command, self._time_s)

    def resume_plan(self, robot: int) -> None:
        """Resume a plan as `Session.resume_plan`; the path back ignores moving obstacles."""
        self._require_drivable(robot)
        info, command_state, level = self.robots[robot], self._command_queue[robot], self._level
        if level in STICK_LEVELS:
            raise ConfigError(f"{info.name}: at the level {level} robots are driven by hand alone")
        if not self._facts.found[robot]:
            raise ConfigError(f"{info.name}: has no plan: the planner found no way for it")
        if command_state.command == PLAN_COMMAND:
            return
        clearance = (
            info.radius_m + self._scenario.planner.margin_m - command_preparation.CLEARANCE_SLACK_M
        )
        view, speed = self._view.estimated_view, info.cruise_speed_mps
        p, velocity = (
            np.asarray(view.p[robot], float),
            command_preparation.ground_velocity(view, robot),
        )
        yaw = float(view.yaw_rad[robot])
        rejoin_path = self._rejoin_paths.plan_rejoin(
            p,
            velocity,
            command_state.plan,
            command_state.plan_time_s,
            clearance,
            speed,
            yaw,
            view.arm_position(robot),
        )
        if rejoin_path is None or rejoin_path.time_s.size > self._limits.rows(rejoin_path.kind):
            raise ConfigError(
                f"{info.name}: no way back to its plan was found from ({p[0]:.2f}, {p[1]:.2f}, "
                f"{p[2]:.2f}) m; bring it nearer"
            )
        self._command_queue.resume(robot, rejoin_path)

    @property
    def autopilots(self) -> A:
        """Autopilots of the scene, for close inspection."""
        self._require_open()
        if self._autopilots is None:
            raise RunError("the autopilots are down; reset the session, or open another")
        return self._autopilots

    @abstractmethod
    def reset(self, seed: int | None = None) -> Observation:
        """Reset as `Session.reset`."""

    def close(self) -> None:
        """Close as `Session.close`: no autopilot is left connected."""
        self._require_open()
        self._stop_autopilots()
        self._closed = True

    def _load_facts(self) -> None:
        """Load the facts of the scene's world, after it was sampled."""
        # An index on the device is a program each.
        worlds_on_host = jax.device_get(self._scene.worlds)
        facts = fleet_facts.gather_facts(self._simulator, worlds_on_host)
        self._facts = levels.adapt_facts(self._level, facts)
        self._rejoin_paths = RejoinPaths(jax.tree.map(lambda x: x[0], worlds_on_host.environment))

    def _reset_commands(self) -> None:
        """Give every robot its plan, and reset the controllers."""
        dtype = self._scene.state.vehicles.p.dtype
        self._command_queue = CommandQueue(self._spec.stages, self._facts, self._limits, dtype)
        self._command_sender.reset(self._scene, self._command_queue.slots.commands())

    def _begin_view(self) -> None:
        """Observe for the first time."""
        self._steps = 0
        self._view = SessionView(
            self._scene, self._facts, self._tolerances, use_truth=self._uses_truth
        )
        self._view.begin(self.autopilots, self._command_queue, self._command_sender)

    def _hold(self, robot: int) -> None:
        """Command a robot to stay where it is."""
        view = self._view.estimated_view
        hold = command_preparation.hold_command((PoseTarget,), view, robot, self._limits)
        self._command_queue.give_command(robot, hold, view, 0.0)

    @abstractmethod
    def _advance_period(self) -> None:
        """Advance one control period: decide, send, step, judge."""

    def _stop_autopilots(self) -> None:
        """Close the autopilots, if there are any."""
        if self._autopilots is not None:
            self._autopilots.close()
            self._autopilots = None

    @property
    def _time_s(self) -> float:
        return self._steps * self.dt_s

    @property
    def _limits(self) -> CommandLimits:
        return self._facts.command_limits(self._points, self._start_tolerance)

    def _collect_status(self) -> tuple[RobotStatus, ...]:
        """Return the status of each robot, with the note of its autopilot."""
        statuses = self._command_queue.status(np.asarray(self._view.view.outcome).tolist())
        notes = [self.autopilots.note(i) for i in range(len(statuses))]
        return tuple(
            replace(status, note="; ".join(part for part in (status.note, note) if part))
            for status, note in zip(statuses, notes, strict=True)
        )

    def _require_open(self) -> None:
        if self._closed:
            raise RunError("the session is closed; make a new one")

    def _require_drivable(self, robot: int) -> None:
        """Raise unless a robot can be driven: it has not failed and its autopilot runs."""
        self._require_open()
        if reason := self.autopilots.lost.get(robot):
            raise ConfigError(f"{self.robots[robot].name}: cannot go on: {reason}")
        robot_checks.require_running(self.robots, robot, self._view.view.outcome)
