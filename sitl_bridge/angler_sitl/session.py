"""Session over real ArduSub autopilots, with the commands, observations and plans of any session.

The world of the scenario, its water and its vehicles are the simulator's. The vehicles are steered
by N firmware processes, stepped together with the water at 400 Hz.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Literal, Self

import jax
import numpy as np

from angler_mjx.errors import ConfigError, RunError
from angler_mjx.robot.control.commands import PoseTarget
from angler_mjx.robot.control.commands.joint_tolerance import Tolerances
from angler_mjx.robot.vehicles import library
from angler_mjx.runs.session import (
    command_preparation,
    command_validation,
    fleet_facts,
    robot_checks,
)
from angler_mjx.runs.session.batch_session import (
    DEFAULT_POINTS,
    DEFAULT_START_TOLERANCE,
    SessionInternals,
)
from angler_mjx.runs.session.command_queue import PLAN_COMMAND, CommandQueue
from angler_mjx.runs.session.command_validation import CommandLimits, RobotPosition
from angler_mjx.runs.session.interface import (
    Observation,
    RobotInfo,
    RobotStatus,
    SessionCommand,
)
from angler_mjx.runs.session.rejoin import RejoinPaths
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.sim.state import World
from angler_sitl.autopilots.autopilots import DEFAULT_HOME, Autopilots, AutopilotSettings
from angler_sitl.autopilots.boot import WorldOrigin
from angler_sitl.autopilots.session_view import SessionView
from angler_sitl.firmware import binary as binaries
from angler_sitl.firmware import parameters as firmware
from angler_sitl.firmware.parameters import CommandLevel, PositionSource
from angler_sitl.scene.scenario_options import parse_speed, select_scenario
from angler_sitl.scene.scene import AutopilotScene
from angler_sitl.steering import levels
from angler_sitl.steering.autopilot_commander import AUTO_MODE
from angler_sitl.steering.command_sender import CommandSender
from angler_sitl.steering.levels import STICK_LEVELS
from angler_sitl.wire.mission_upload import UploadItem


class SitlSession:
    """`Session` over one world of a scenario, steered by real autopilots; a context manager."""

    def __init__(
        self,
        scenario: Scenario | str | Path,
        *,
        world: int = 0,
        level: CommandLevel = "guided",
        source: PositionSource = "vision",
        estimate: Literal["ekf", "truth"] = "ekf",
        speed: Literal["max"] | float = "max",
        binary: Path | None = None,
        folder: Path | None = None,
        robots: int | None = None,
        on_crash: Literal["end", "hold"] = "end",
        parameters: Mapping[str, float] | None = None,
        points: int = DEFAULT_POINTS,
        start_tolerance: float = DEFAULT_START_TOLERANCE,
        tolerances: Tolerances | None = None,
        home: WorldOrigin | None = None,
        missions: Sequence[Sequence[UploadItem]] = (),
    ) -> None:
        """Compile the scene, start the autopilots and bring them up.

        Args:
            scenario: the scenario, its name, or its file.
            world: index of the world in the scenario.
            level: where commands enter: see `angler_sitl.steering.levels`.
            source: position source of the autopilots' filters.
            estimate: input of our own controllers and checks: the autopilots' filters, or the
                truth.
            speed: max speed, times real time, or ``max``.
            binary: ArduSub executable; else the environment's ``ANGLER_ARDUSUB``, or the installed
                one.
            folder: folder for each robot's logs; none are kept if left out.
            robots: number of robots; the scenario's if left out.
            on_crash: whether the loss of one autopilot ends the scene, or the others go on.
            parameters: firmware parameters that extend or override the defaults.
            points: max number of points of a JointTrajectory.
            start_tolerance: max distance from a robot to the start of a path, m and rad; 0 is any
                distance.
            tolerances: of JointTrajectories, for x, y, z and yaw; those of `paths` if left out.
            home: position of W's origin on the globe; one in the sea if left out.
            missions: mission items of each robot, home first, for `start_missions`.

        Raises:
            ConfigError: no such world, level, source or ArduSub, or a vehicle without its frame.
            RunError: an autopilot does not come up.
        """
        if world < 0:
            raise ConfigError(f"world = {world}: worlds are counted from 0")
        self._scenario = select_scenario(scenario, robots)
        for entry in self._scenario.fleet:  # before compiling, which takes a minute
            firmware.for_vehicle(library.load_vehicle(entry.vehicle), level, source)
        self._tolerances = command_preparation.stack_tolerances(tolerances, self._scenario)
        self._points, self._start_tolerance = points, start_tolerance
        self._estimate, self._closed = estimate, False
        self.settings = AutopilotSettings(  # of the next reset
            binary=binaries.find_binary(binary),
            level=level,
            source=source,
            speed=parse_speed(speed),
            folder=folder,
            parameters=dict(parameters or {}),
            on_crash=on_crash,
            missions=missions,
            home=home or DEFAULT_HOME,
        )
        self._scene = AutopilotScene(self._scenario, world=world)
        self._simulator = self._scene.simulator
        vehicles = [library.load_vehicle(entry.vehicle) for entry in self._scenario.fleet]
        self._spec = levels.build_level_spec(
            level,
            self._simulator.spec,
            has_end_effector=any(vehicle.end_effector is not None for vehicle in vehicles),
        )
        self._command_sender = CommandSender(level, self._spec)
        self._is_on_last_leg: Callable[[int], bool] = lambda _: False
        self._autopilots: Autopilots | None = None
        self._sampled_seed: int | None = None
        self.reset()

    def __enter__(self) -> Self:
        """Return the context manager itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the autopilots."""
        self._stop_autopilots()

    @property
    def robots(self) -> Sequence[RobotInfo]:
        """Robots of the scene, in order."""
        return self._facts.robots

    @property
    def dt_s(self) -> float:
        """Control period, s."""
        return self._spec.control_dt_s

    @property
    def autopilots(self) -> Autopilots:
        """Autopilots of the scene, for close inspection."""
        self._require_open()
        if self._autopilots is None:
            raise RunError("the autopilots are down; reset the session")
        return self._autopilots

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

    def reset(self, seed: int | None = None, *, worlds: World | None = None) -> Observation:
        """Reset as `Session.reset`: new processes, armed, vehicles at rest at their starts.

        If ``worlds`` is given, no world is sampled; [1] leads, shapes stay.
        """
        self._require_open()
        self._stop_autopilots()
        used_seed = self._scenario.seed if seed is None else seed
        self._scene.reset(used_seed, worlds)
        if worlds is not None or used_seed != self._sampled_seed:
            worlds_on_host = jax.device_get(
                self._scene.worlds
            )  # an index on the device is a program each
            facts = fleet_facts.gather_facts(self._simulator, worlds_on_host)
            self._facts = levels.adapt_facts(self.settings.level, facts)
            self._rejoin_paths = RejoinPaths(
                jax.tree.map(lambda x: x[0], worlds_on_host.environment)
            )
            self._sampled_seed = used_seed if worlds is None else None
        dtype = self._scene.state.vehicles.p.dtype
        self._command_queue = CommandQueue(self._spec.stages, self._facts, self._limits, dtype)
        self._command_sender.reset(self._scene, self._command_queue.slots.commands())
        self._autopilots = Autopilots(self.settings, self._scene, tuple(self.robots))
        self._scene.moored, self._steps = False, 0
        self._view = SessionView(
            self._scene, self._facts, self._tolerances, use_truth=self._estimate == "truth"
        )
        self._view.begin(self._autopilots, self._command_queue, self._command_sender)
        if self.settings.level in STICK_LEVELS:  # no plan can be followed at stick levels
            for robot in range(len(self.robots)):
                hold = command_preparation.hold_command(
                    (PoseTarget,), self._view.estimated_view, robot, self._limits
                )
                self._command_queue.give_command(robot, hold, self._view.estimated_view, 0.0)
        return self.observe()

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
        info, command_state, level = (
            self.robots[robot],
            self._command_queue[robot],
            self.settings.level,
        )
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

    def start_missions(self, is_on_last_leg: Callable[[int], bool]) -> None:
        """Switch all robots to AUTO, in which the firmware flies its mission.

        From then on they receive no commands; `step` advances them as before.

        Args:
            is_on_last_leg: whether a robot, by its index, flies the last leg of its mission: only
                there it can arrive at its goal.

        Raises:
            RunError: there are no missions.
        """
        if not self.settings.missions:
            raise RunError("no missions were uploaded; open the session with missions")
        pilots = self.autopilots.pilots
        self._command_sender.silent = frozenset(range(len(pilots)))
        self._is_on_last_leg = is_on_last_leg
        for pilot in pilots:
            pilot.set_mode(AUTO_MODE)

    def close(self) -> None:
        """Close as `Session.close`: no autopilot is left running."""
        self._require_open()
        self._stop_autopilots()
        self._closed = True

    @property
    def _time_s(self) -> float:
        return self._steps * self.dt_s

    @property
    def _limits(self) -> CommandLimits:
        return self._facts.command_limits(self._points, self._start_tolerance)

    def _advance_period(self) -> None:
        """Advance one control period: decide, send, step, judge."""
        scene, autopilots = self._scene, self.autopilots
        before = scene.state
        decision = self._command_sender.steer(
            scene,
            autopilots.pilots,
            self.robots,
            self._view.belief,
            self._command_queue.slots.commands(),
        )
        autopilots.advance()
        approaching = np.array(decision.approaching)[0]
        for robot in self._command_sender.silent:
            approaching[robot] = self._is_on_last_leg(robot)
        scene.judge(approaching)
        self._steps += 1
        self._view.record_step(before, decision)

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
        if reason := self.autopilots.lockstep.lost.get(robot):
            raise ConfigError(f"{self.robots[robot].name}: cannot go on: {reason}")
        robot_checks.require_running(self.robots, robot, self._view.view.outcome)

    def _stop_autopilots(self) -> None:
        """Close the autopilots, if there are any."""
        if self._autopilots is not None:
            self._autopilots.close()
            self._autopilots = None
