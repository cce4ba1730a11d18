"""Session over real ArduSub autopilots, with the commands, observations and plans of any session.

The world of the scenario, its water and its vehicles are the simulator's. The vehicles are steered
by N firmware processes, stepped together with the water at 400 Hz.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Literal, Self

import numpy as np

from angler_mjx.errors import ConfigError, RunError
from angler_mjx.robot.control.commands.joint_tolerance import Tolerances
from angler_mjx.robot.vehicles import library
from angler_mjx.runs.session import command_preparation
from angler_mjx.runs.session.batch_session import DEFAULT_POINTS, DEFAULT_START_TOLERANCE
from angler_mjx.runs.session.interface import Observation
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.sim.state import World
from angler_sitl.autopilot_session import AutopilotSession
from angler_sitl.autopilots.autopilots import DEFAULT_HOME, Autopilots, AutopilotSettings
from angler_sitl.autopilots.boot import WorldOrigin
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


class SitlSession(AutopilotSession[Autopilots]):
    """`Session` over one world of a scenario, steered by ArduSub processes; a context manager.

    Commands, observations and shapes are those of `Session`: lengths in m in W (x east, y north, z
    up), velocities in F, signals in us. Processes and water are stepped together at 400 Hz. Levels,
    estimates and times: `docs/reference/sitl.md`.

    Attributes:
        settings: settings of the autopilots that the next reset starts.
    """

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
            tolerances: tolerances of JointTrajectories for x, y, z and yaw; those of `paths` if
                left out.
            home: position of W's origin on the globe; one in the sea if left out.
            missions: mission items of each robot, home first, for `start_missions`.

        Raises:
            ConfigError: no such world, level, source or ArduSub, or a vehicle without its frame.
            RunError: an autopilot does not come up.
        """
        if world < 0:
            raise ConfigError(f"world = {world}: worlds are counted from 0")
        selected = select_scenario(scenario, robots)
        vehicles = [library.load_vehicle(entry.vehicle) for entry in selected.fleet]
        for vehicle in vehicles:  # before compiling, which takes a minute
            firmware.for_vehicle(vehicle, level, source)
        command_preparation.stack_tolerances(tolerances, selected)
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
        scene = AutopilotScene(selected, world=world)
        spec = levels.build_level_spec(
            level,
            scene.simulator.spec,
            has_end_effector=any(vehicle.end_effector is not None for vehicle in vehicles),
        )
        super().__init__(
            selected,
            scene,
            CommandSender(level, spec),
            level=level,
            points=points,
            start_tolerance=start_tolerance,
            tolerances=tolerances,
            use_truth=estimate == "truth",
        )
        self._is_on_last_leg: Callable[[int], bool] = lambda _: False
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

    def reset(self, seed: int | None = None, *, worlds: World | None = None) -> Observation:
        """Reset as `Session.reset`: new processes, armed, vehicles at rest at their starts.

        Args:
            seed: seed of all samples; that of the scenario if left out.
            worlds: world [1] to fly in place of a sampled one, with the shapes of the sampled one.

        Raises:
            RunError: the session is closed, or an autopilot does not come up.
        """
        self._require_open()
        self._stop_autopilots()
        used_seed = self._scenario.seed if seed is None else seed
        self._scene.reset(used_seed, worlds)
        if worlds is not None or used_seed != self._sampled_seed:
            self._load_facts()
            self._sampled_seed = used_seed if worlds is None else None
        self._reset_commands()
        self._autopilots = Autopilots(self.settings, self._scene, tuple(self.robots))
        self._scene.moored = False
        self._begin_view()
        if self.settings.level in STICK_LEVELS:  # no plan can be followed at stick levels
            for robot in range(len(self.robots)):
                self._hold(robot)
        return self.observe()

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
