"""Autopilots of a scene, started, brought up, stepped and closed together."""

import shutil
import tempfile
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray

from angler_mjx.robot.vehicles import library
from angler_mjx.runs.session.interface import RobotInfo
from angler_sitl.autopilots.boot import BootTimes, WorldOrigin, boot_autopilots
from angler_sitl.autopilots.lockstep import LockStep
from angler_sitl.firmware import parameters as firmware
from angler_sitl.firmware import source_ports
from angler_sitl.firmware.binary import Binary
from angler_sitl.firmware.parameters import CommandLevel, PositionSource
from angler_sitl.firmware.process import (
    HOME_LAT_DEG,
    HOME_LON_DEG,
    AutopilotProcess,
    LaunchSpec,
    kill_processes,
)
from angler_sitl.scene.scene import AutopilotScene
from angler_sitl.steering import sticks
from angler_sitl.steering.autopilot_commander import (
    EstimatedMotion,
    SimulatedCommander,
    collect_motion,
)
from angler_sitl.steering.levels import LEVEL_MODES
from angler_sitl.steering.navigation import Navigation
from angler_sitl.wire import ports as sockets
from angler_sitl.wire.link import TLOG_NAME, TelemetryLog
from angler_sitl.wire.mission_upload import UploadItem

FIX_AGE_S = 0.03
"""Delay [s] of external navigation when it is sent.

The firmware assumes this delay: half a step of its filter, plus the transmission time on a wire.
Without the delay its position runs 24 ms ahead of the truth. With it the position is within 10 ms
of the truth, a step of its filter."""

DEFAULT_HOME = WorldOrigin(lat_deg=HOME_LAT_DEG, lon_deg=HOME_LON_DEG)
"""Position of W's origin where none is named."""


@dataclass(frozen=True, kw_only=True)
class AutopilotSettings:
    """Settings of the autopilots.

    Attributes:
        binary: ArduSub executable.
        level: where commands enter.
        source: position source of their filters.
        speed: max speed, times real time; None for no limit.
        folder: folder of their logs; None for no logs.
        parameters: firmware parameters that extend or override the defaults.
        on_crash: whether the loss of one autopilot ends the scene, or the others go on.
        home: position of W's origin on the globe.
        missions: mission items of each robot, home first; no missions if empty.
    """

    binary: Binary
    level: CommandLevel = "guided"
    source: PositionSource = "vision"
    speed: float | None = None
    folder: Path | None = None
    parameters: Mapping[str, float] = field(default_factory=dict)
    on_crash: Literal["end", "hold"] = "end"
    home: WorldOrigin = DEFAULT_HOME
    missions: Sequence[Sequence[UploadItem]] = ()


class Autopilots:
    """All autopilots of a scene, in lock-step with it; a context manager.

    Attributes:
        pilots: one commander per autopilot.
        instances: their processes.
        ready: record of the start-up.
        differences: parameters that the autopilots did not accept, by robot name.
    """

    def __init__(
        self, settings: AutopilotSettings, scene: AutopilotScene, robots: tuple[RobotInfo, ...]
    ) -> None:
        """Start the autopilots and bring them up: armed, in their mode, vehicles still moored.

        Raises:
            ConfigError: more robots than system numbers, or a vehicle without a matching frame.
            RunError: an autopilot does not come up. No process is left running.
        """
        self._settings, self._scene = settings, scene
        self._exit = ExitStack()
        try:
            start_s = time.perf_counter()
            self._start_processes(robots)
            self._lockstep.set_speed(None)  # no limit: nothing moves until the autopilots are armed
            ready = boot_autopilots(
                self.pilots,
                self._advance_boot,
                mode=LEVEL_MODES[settings.level],
                source=settings.source,
                home=settings.home,
                missions=settings.missions,
            )
            self._lockstep.set_speed(settings.speed)
            self.ready = BootTimes(sim_s=ready.sim_s, wall_s=time.perf_counter() - start_s)
            self.differences = {
                pilot.name: firmware.find_differences(
                    self._parameter_sets[i], pilot.link.parameters
                )
                for i, pilot in enumerate(self.pilots)
            }
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Self:
        """Return the context manager itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close all autopilots."""
        self.close()

    @property
    def time_s(self) -> float:
        """Time of the autopilots' clock, s."""
        return self._scene.time_s

    @property
    def lockstep(self) -> LockStep:
        """Lock-step that steps the autopilots."""
        return self._lockstep

    @property
    def pwm(self) -> NDArray[np.int32]:
        """Last pulse widths [R, 16], us."""
        return self._lockstep.pwm

    @property
    def lost(self) -> Mapping[int, str]:
        """Reason of each lost autopilot, by the robot's index."""
        return self._lockstep.lost

    def estimate_motion(self) -> EstimatedMotion:
        """Return the autopilots' estimates of their own motion at the current time."""
        return collect_motion(self.pilots, self.time_s)

    def note(self, robot: int) -> str:
        """Return a short note on the state of a robot's autopilot."""
        reason = self._lockstep.lost.get(robot)
        return self.pilots[robot].note() if reason is None else f"lost: {reason.partition('; ')[0]}"

    def advance(self) -> None:
        """Advance one control period: step, receive telemetry, send position fixes.

        Raises:
            RunError: an autopilot crashed, hangs or restarted.
        """
        steps_after_fix = round(FIX_AGE_S / self._scene.dt_s)
        self._lockstep.advance(self._scene.steps_per_period - steps_after_fix)
        fixes = self._navigation.build_fixes() if self._settings.source == "vision" else ()
        self._lockstep.advance(steps_after_fix)
        for pilot in self.pilots:
            pilot.tick(self.time_s)
        for pilot, fix in zip(self.pilots, fixes, strict=False):
            pilot.send_fix(self.time_s, fix)

    def close(self) -> None:
        """Close all autopilots; a second call has no effect."""
        self._exit.close()

    def _advance_boot(self) -> float:
        if self._settings.level == "thrusters":
            # Without these pulses the outputs are 0, which its battery takes for full reverse.
            for pilot in self.pilots:
                pilot.send_neutral()
        self.advance()
        return self.time_s

    def _start_processes(self, robots: tuple[RobotInfo, ...]) -> None:
        settings = self._settings
        self._parameter_sets = [self._build_parameters(robot) for robot in robots]
        folder = settings.folder or Path(tempfile.mkdtemp(prefix="angler_sitl_"))
        if settings.folder is None:
            self._exit.callback(shutil.rmtree, folder, ignore_errors=True)
        all_ports = sockets.allocate_ports(len(robots))
        for ports in all_ports:
            self._exit.callback(ports.close)
        launches = [
            LaunchSpec(
                binary=settings.binary,
                folder=folder / robot.name,
                name=robot.name,
                sysid=i + 1,
                ports=all_ports[i],
                parameters=self._parameter_sets[i],
                home_deg=(settings.home.lat_deg, settings.home.lon_deg),
            )
            for i, robot in enumerate(robots)
        ]
        self.instances: list[AutopilotProcess] = []
        self._exit.callback(kill_processes, self.instances)
        for launch in launches:
            self.instances.append(AutopilotProcess(launch))
        source_ports.restart_shared_ports(self.instances)
        self.pilots = [self._connect_commander(launch) for launch in launches]
        self._navigation = Navigation(self._scene, self._scene.simulator.spec)
        self._lockstep = LockStep(
            [ports.fdm for ports in all_ports],
            self._scene,
            names=[robot.name for robot in robots],
            fault=lambda i: self.instances[i].fault(),
            condition=lambda i: self.instances[i].condition(),
            speed=settings.speed,
            on_crash=settings.on_crash,
        )

    def _connect_commander(self, launch: LaunchSpec) -> SimulatedCommander:
        if self._settings.folder is None:
            return SimulatedCommander(launch.name, launch.sysid, launch.ports)
        log = TelemetryLog(launch.folder / TLOG_NAME)
        self._exit.callback(log.close)
        return SimulatedCommander(launch.name, launch.sysid, launch.ports, tap=log.log_packet)

    def _build_parameters(self, robot: RobotInfo) -> dict[str, float]:
        settings = self._settings
        vehicle_parameters = firmware.for_vehicle(
            library.load_vehicle(robot.vehicle),
            settings.level,
            settings.source,
            log=settings.folder is not None,
        )
        scales = sticks.stick_parameters(settings.level, robot)
        return {**vehicle_parameters, **scales, **settings.parameters}
