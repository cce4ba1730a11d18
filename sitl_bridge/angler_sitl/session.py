"""Real ArduSub autopilots as a session: the same commands, the same observations, the same plans.

A world of a scenario, its water and its vehicles are the simulator's; what steers them are N
processes of the firmware, stepped together with the water at 400 Hz.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Literal, Self

import jax
import numpy as np

from angler_mjx.errors import ConfigError, RunError
from angler_mjx.robot.control.commands import PoseTarget
from angler_mjx.robot.control.joint_tolerance import Tolerances
from angler_mjx.robot.vehicles import library
from angler_mjx.runs.session import checks, fleet_facts, paths, presence
from angler_mjx.runs.session.batch import POINTS, START_TOLERANCE, Inside
from angler_mjx.runs.session.checks import CommandLimits, RobotPosition
from angler_mjx.runs.session.command_queue import PLAN, CommandQueue
from angler_mjx.runs.session.interface import (
    Observation,
    Order,
    RobotInfo,
    RobotStatus,
)
from angler_mjx.runs.session.rejoin import RejoinPaths
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.sim.state import World
from angler_sitl.autopilots import Autopilots, AutopilotSettings
from angler_sitl.firmware import binary as binaries
from angler_sitl.firmware import parameters as firmware
from angler_sitl.firmware.parameters import Level, Source
from angler_sitl.missions.choosing import scenario_of, speed_of
from angler_sitl.scene.scene import AutopilotScene
from angler_sitl.scene.sight import SessionView
from angler_sitl.steering import levels
from angler_sitl.steering.command_sender import CommandSender
from angler_sitl.steering.levels import STICK_LEVELS


class SitlSession:
    """A `Session` over one world of a scenario that real autopilots steer; a context manager."""

    def __init__(
        self,
        scenario: Scenario | str | Path,
        *,
        world: int = 0,
        level: Level = "guided",
        source: Source = "vision",
        estimate: Literal["ekf", "truth"] = "ekf",
        speed: Literal["max"] | float = "max",
        binary: Path | None = None,
        folder: Path | None = None,
        robots: int | None = None,
        on_crash: Literal["end", "hold"] = "end",
        parameters: Mapping[str, float] | None = None,
        points: int = POINTS,
        start_tolerance: float = START_TOLERANCE,
        tolerances: Tolerances | None = None,
    ) -> None:
        """Compile the scene, start the autopilots and bring them up.

        Args:
            scenario: the scenario, its name, or its file.
            world: which of its worlds.
            level: where commands enter: see `angler_sitl.steering.levels`.
            source: where the autopilots' filters learn their position.
            estimate: what our own controllers and checks go by: the autopilots' filters, or the
                truth.
            speed: times real time at most, or ``max``.
            binary: the ArduSub; else the environment's ``ANGLER_ARDUSUB``, or the installed one.
            folder: where each robot's logs are kept; nowhere if left out.
            robots: so many of the scenario's.
            on_crash: whether the loss of one autopilot ends the scene, or the others go on.
            parameters: of the firmware, beside our own or instead of them.
            points: most points of a JointTrajectory.
            start_tolerance: how far a path may begin from a robot, m and rad; 0 is any distance.
            tolerances: of JointTrajectories, for x, y, z and yaw; those of `paths` if left out.

        Raises:
            ConfigError: no such world, level, source or ArduSub, or a vehicle without its frame.
            RunError: an autopilot does not come up.
        """
        if world < 0:
            raise ConfigError(f"world = {world}: worlds are counted from 0")
        self._scenario = scenario_of(scenario, robots)
        for entry in self._scenario.fleet:  # at once, and not after a minute of compiling
            firmware.for_vehicle(library.load(entry.vehicle), level, source)
        self._allowed = paths.stacked(tolerances, self._scenario)
        self._points, self._start_tolerance = points, start_tolerance
        self._estimate, self._closed = estimate, False
        self.settings = AutopilotSettings(  # of the next reset
            binary=binaries.find(binary),
            level=level,
            source=source,
            speed=speed_of(speed),
            folder=folder,
            parameters=dict(parameters or {}),
            on_crash=on_crash,
        )
        self._scene = AutopilotScene(self._scenario, world=world)
        self._simulator = self._scene.simulator
        self._spec = levels.spec_of(level, self._simulator.spec)
        self._helm = CommandSender(level, self._spec)
        self._autopilots: Autopilots | None = None
        self._drawn: int | None = None
        self.reset()

    def __enter__(self) -> Self:
        """Itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End the autopilots."""
        self._down()

    @property
    def robots(self) -> Sequence[RobotInfo]:
        """Who is there, in order."""
        return self._facts.robots

    @property
    def dt_s(self) -> float:
        """Control period, s."""
        return self._spec.control_dt_s

    @property
    def autopilots(self) -> Autopilots:
        """The autopilots, for those who look at them closely."""
        self._open()
        if self._autopilots is None:
            raise RunError("the autopilots are down; reset the session")
        return self._autopilots

    def inside(self) -> Inside:
        """What lies behind the scene, for recordings; it is to be looked at, not to be changed."""
        self._open()
        return Inside(
            simulator=self._simulator,
            worlds=self._scene.worlds,
            state=self._scene.state,
            sample=self._sight.sample,
        )

    def reset(self, seed: int | None = None, *, worlds: World | None = None) -> Observation:
        """See `Session.reset`: fresh processes, up and armed, vehicles at rest at their starts.

        No world is drawn if ``worlds`` is one; [1] leads, shapes stay.
        """
        self._open()
        self._down()
        number = self._scenario.seed if seed is None else seed
        self._scene.reset(number, worlds)
        if worlds is not None or number != self._drawn:
            here = jax.device_get(self._scene.worlds)  # an index on the device is a program each
            gathered = fleet_facts.gather(self._simulator, here)
            self._facts = levels.facts_of(self.settings.level, gathered)
            self._ways = RejoinPaths(jax.tree.map(lambda x: x[0], here.environment))
            self._drawn = number if worlds is None else None
        dtype = self._scene.state.vehicles.p.dtype
        self._orders = CommandQueue(self._spec.stages, self._facts, self._limits, dtype)
        self._helm.reset(self._scene, self._orders.slots.commands())
        self._autopilots = Autopilots(self.settings, self._scene, tuple(self.robots))
        self._scene.moored, self._steps = False, 0
        self._sight = SessionView(
            self._scene, self._facts, self._allowed, truth=self._estimate == "truth"
        )
        self._sight.begin(self._autopilots, self._orders, self._helm)
        if self.settings.level in STICK_LEVELS:  # nobody can follow a plan there
            for robot in range(len(self.robots)):
                here = paths.hold((PoseTarget,), self._sight.seen, robot, self._limits)
                self._orders.tell(robot, here, self._sight.seen, 0.0)
        return self.observe()

    def step(self, commands: Mapping[int, Order] | None = None) -> Observation:
        """See `Session.step`."""
        self._open()
        for robot in commands or {}:
            presence.is_there(self.robots, robot)
        # Half a period: times are sums in floating point.
        soon_s = self._time_s + 0.5 * self.dt_s
        for robot, order in {**self._orders.due(soon_s), **(commands or {})}.items():
            try:
                self.check(robot, order)
            except ConfigError as error:
                self._orders.refuse(robot, str(error), self._sight.seen)
            else:
                self._orders.tell(robot, order, self._sight.seen, soon_s)
        try:
            self._go_on()
        except BaseException:
            self._down()
            raise
        self._sight.look(self.autopilots, self._orders, self._helm)
        self._orders.report(self._sight.seen)
        return self.observe()

    def observe(self) -> Observation:
        """See `Session.observe`."""
        self._open()
        return self._sight.observation(self._time_s, self._status())

    def check(self, robot: int, command: Order) -> None:
        """See `Session.check`."""
        self._goes_on(robot)
        info, seen = self.robots[robot], self._sight.seen
        place = RobotPosition(
            p=np.asarray(seen.p[robot], float), yaw_rad=float(seen.yaw_rad[robot])
        )
        checks.check(info, place, self._limits, command, self._time_s)

    def resume_plan(self, robot: int) -> None:
        """See `Session.resume_plan`; what moves is not looked at on the way back."""
        self._goes_on(robot)
        info, told, level = self.robots[robot], self._orders[robot], self.settings.level
        if level in STICK_LEVELS:
            raise ConfigError(f"{info.name}: at the level {level} robots are driven by hand alone")
        if not self._facts.found[robot]:
            raise ConfigError(f"{info.name}: has no plan: the planner found no way for it")
        if told.command == PLAN:
            return
        clearance = info.radius_m + self._scenario.planner.margin_m - paths.SLACK_M
        seen, speed = self._sight.seen, info.cruise_speed_mps
        p, velocity = np.asarray(seen.p[robot], float), paths.over_ground(seen, robot)
        yaw = float(seen.yaw_rad[robot])
        back = self._ways.back(p, velocity, told.plan, told.left_s, clearance, speed, yaw)
        if back is None or back.time_s.size > self._limits.rows(back.kind):
            raise ConfigError(
                f"{info.name}: no way back to its plan was found from ({p[0]:.2f}, {p[1]:.2f}, "
                f"{p[2]:.2f}) m; bring it nearer"
            )
        self._orders.resume(robot, back)

    def close(self) -> None:
        """See `Session.close`: no autopilot is left running."""
        self._open()
        self._down()
        self._closed = True

    @property
    def _time_s(self) -> float:
        return self._steps * self.dt_s

    @property
    def _limits(self) -> CommandLimits:
        return self._facts.limits(self._points, self._start_tolerance)

    def _go_on(self) -> None:
        """One control period: decide, send, step, judge."""
        scene, autopilots = self._scene, self.autopilots
        before = scene.state
        decision = self._helm.steer(
            scene, autopilots.pilots, self.robots, self._sight.belief, self._orders.slots.commands()
        )
        autopilots.advance()
        scene.judge(np.asarray(decision.approaching)[0])
        self._steps += 1
        self._sight.keep(before, decision)

    def _status(self) -> tuple[RobotStatus, ...]:
        """As of the orders, and how each autopilot stands."""
        told = self._orders.status(np.asarray(self._sight.view.outcome).tolist())
        stands = [self.autopilots.note(i) for i in range(len(told))]
        return tuple(
            replace(status, note="; ".join(part for part in (status.note, note) if part))
            for status, note in zip(told, stands, strict=True)
        )

    def _open(self) -> None:
        if self._closed:
            raise RunError("the session is closed; make a new one")

    def _goes_on(self, robot: int) -> None:
        """Refuse to drive a robot that failed, or whose autopilot is gone."""
        self._open()
        if why := self.autopilots.lockstep.lost.get(robot):
            raise ConfigError(f"{self.robots[robot].name}: cannot go on: {why}")
        presence.goes_on(self.robots, robot, self._sight.view.outcome)

    def _down(self) -> None:
        """End the autopilots, if there are any."""
        if self._autopilots is not None:
            self._autopilots.close()
            self._autopilots = None
