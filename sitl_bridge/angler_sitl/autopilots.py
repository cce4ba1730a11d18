"""The autopilots of a scene: started, brought up, stepped together, and ended together."""

import shutil
import tempfile
import time
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Literal, Self

from angler_mjx.robot.vehicles import library
from angler_mjx.runs.session.interface import RobotInfo
from angler_sitl.firmware import parameters as firmware
from angler_sitl.firmware.binary import Binary
from angler_sitl.firmware.boot import Ready, WorldOrigin, boot
from angler_sitl.firmware.parameters import Level, Source
from angler_sitl.firmware.process import (
    HOME_LAT_DEG,
    HOME_LON_DEG,
    Instance,
    Launch,
    kill_all,
)
from angler_sitl.scene.scene import AutopilotScene
from angler_sitl.steering import sticks
from angler_sitl.steering.levels import MODES
from angler_sitl.steering.navigation import Navigation
from angler_sitl.steering.pilot import AutopilotCommander, PilotMotion, motion_of
from angler_sitl.wire import calling
from angler_sitl.wire import ports as sockets
from angler_sitl.wire.lockstep import LockStep
from angler_sitl.wire.tlog import NAME, Telemetry

FIX_AGE_S = 0.03
"""How old external navigation is when it is sent. The firmware takes it for so much older than when
it came: half a step of its filter, and the time that the bytes would need on a wire. Sent at once,
it would have its position run 24 ms ahead of the truth; so it is within 10 ms of it, a step of its
filter."""


@dataclass(frozen=True, kw_only=True)
class AutopilotSettings:
    """How autopilots are run.

    Attributes:
        binary: the ArduSub.
        level: where commands enter.
        source: where their filters learn their position.
        speed: times real time, at most; None as fast as it goes.
        folder: for their logs; None keeps nothing.
        parameters: of the firmware, beside our own or instead of them.
        on_crash: whether the loss of one autopilot ends the scene, or the others go on.
    """

    binary: Binary
    level: Level = "guided"
    source: Source = "vision"
    speed: float | None = None
    folder: Path | None = None
    parameters: Mapping[str, float] = field(default_factory=dict)
    on_crash: Literal["end", "hold"] = "end"


class Autopilots:
    """All autopilots of a scene, in lock-step with it; a context manager.

    Attributes:
        pilots: each of them.
        instances: their processes.
        ready: what it took to bring them up.
        differences: parameters that they did not take, by robot's name.
    """

    def __init__(
        self, settings: AutopilotSettings, scene: AutopilotScene, robots: tuple[RobotInfo, ...]
    ) -> None:
        """Start them and bring them up: armed, in their mode, their vehicles still moored.

        Raises:
            ConfigError: more robots than system numbers, or a vehicle without a matching frame.
            RunError: one of them does not come up. None is left running.
        """
        self._settings, self._scene = settings, scene
        self._exit = ExitStack()
        try:
            began = time.perf_counter()
            self._start(robots)
            self._lockstep.pace(None)  # nothing moves until they are armed
            ready = boot(
                self.pilots,
                self._advance_boot,
                mode=MODES[settings.level],
                source=settings.source,
                home=WorldOrigin(lat_deg=HOME_LAT_DEG, lon_deg=HOME_LON_DEG),
            )
            self._lockstep.pace(settings.speed)
            self.ready = Ready(sim_s=ready.sim_s, wall_s=time.perf_counter() - began)
            self.differences = {
                pilot.name: firmware.differences(self._given[i], pilot.link.parameters)
                for i, pilot in enumerate(self.pilots)
            }
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Self:
        """Itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End them all."""
        self.close()

    @property
    def time_s(self) -> float:
        """Their clock."""
        return self._scene.time_s

    @property
    def lockstep(self) -> LockStep:
        """What steps them."""
        return self._lockstep

    def motion(self) -> PilotMotion:
        """What they believe of their own motion, now."""
        return motion_of(self.pilots, self.time_s)

    def note(self, robot: int) -> str:
        """How one of them stands."""
        why = self._lockstep.lost.get(robot)
        return self.pilots[robot].note() if why is None else f"lost: {why.partition('; ')[0]}"

    def advance(self) -> None:
        """One control period: step, take what they say, and tell them where they were.

        Raises:
            RunError: one of them crashed, hangs or began anew.
        """
        half = round(FIX_AGE_S / self._scene.dt_s)
        self._lockstep.advance(self._scene.period - half)
        fixes = self._navigation.fixes() if self._settings.source == "vision" else ()
        self._lockstep.advance(half)
        for pilot in self.pilots:
            pilot.tick(self.time_s)
        for pilot, fix in zip(self.pilots, fixes, strict=False):
            pilot.navigate(self.time_s, fix)

    def close(self) -> None:
        """End them all; twice does no harm."""
        self._exit.close()

    def _advance_boot(self) -> float:
        if self._settings.level == "thrusters":
            # Without a word of ours these outputs are 0, which its battery takes for full reverse.
            for pilot in self.pilots:
                pilot.neutral()
        self.advance()
        return self.time_s

    def _start(self, robots: tuple[RobotInfo, ...]) -> None:
        settings = self._settings
        self._given = [self._parameters(robot) for robot in robots]
        folder = settings.folder or Path(tempfile.mkdtemp(prefix="angler_sitl_"))
        if settings.folder is None:
            self._exit.callback(shutil.rmtree, folder, ignore_errors=True)
        bound = sockets.allocate(len(robots))
        for ports in bound:
            self._exit.callback(ports.close)
        launches = [
            Launch(
                binary=settings.binary,
                folder=folder / robot.name,
                name=robot.name,
                sysid=i + 1,
                ports=bound[i],
                parameters=self._given[i],
            )
            for i, robot in enumerate(robots)
        ]
        self.instances: list[Instance] = []
        self._exit.callback(kill_all, self.instances)
        for launch in launches:
            self.instances.append(Instance(launch))
        calling.settle(self.instances)
        self.pilots = [self._pilot(launch) for launch in launches]
        self._navigation = Navigation(self._scene, self._scene.simulator.spec)
        self._lockstep = LockStep(
            [ports.fdm for ports in bound],
            self._scene,
            names=[robot.name for robot in robots],
            fault=lambda i: self.instances[i].fault(),
            condition=lambda i: self.instances[i].condition(),
            speed=settings.speed,
            on_crash=settings.on_crash,
        )

    def _pilot(self, launch: Launch) -> AutopilotCommander:
        if self._settings.folder is None:
            return AutopilotCommander(launch.name, launch.sysid, launch.ports)
        log = Telemetry(launch.folder / NAME)
        self._exit.callback(log.close)
        return AutopilotCommander(launch.name, launch.sysid, launch.ports, tap=log.tap)

    def _parameters(self, robot: RobotInfo) -> dict[str, float]:
        settings = self._settings
        ours = firmware.for_vehicle(
            library.load(robot.vehicle),
            settings.level,
            settings.source,
            log=settings.folder is not None,
        )
        scales = sticks.parameters(settings.level, robot)
        return {**ours, **scales, **settings.parameters}
