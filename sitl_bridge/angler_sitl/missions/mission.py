"""A whole flight of a scenario on real autopilots: checked, booted, flown, and recorded."""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from angler_mjx.errors import ConfigError, RunError
from angler_mjx.robot.control.joint_goal import JointGoal
from angler_mjx.runs.session.recording import RecordedCourse, SessionRecording
from angler_mjx.runs.storage import folder
from angler_mjx.runs.storage.folder import Run
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.teleop.loop import Watcher
from angler_mjx.teleop.signals import breakable, stoppable
from angler_sitl import autopilots as running
from angler_sitl.autopilots import Autopilots
from angler_sitl.firmware import binary as binaries
from angler_sitl.firmware import parameters as firmware
from angler_sitl.firmware.parameters import Level, Source
from angler_sitl.firmware.probe import read_version
from angler_sitl.missions import plans
from angler_sitl.missions.flight import MissionFlight, fly
from angler_sitl.session import SitlSession
from angler_sitl.steering.levels import STICK_LEVELS
from angler_sitl.wire.ground_station import GroundStation
from angler_sitl.wire.ports import MOST_VEHICLES

type Tell = Callable[[str], None]
"""Told in words what is going on."""
type Display = Callable[[SitlSession], AbstractContextManager[Watcher]]
"""Makes what shows how everybody stands."""


@dataclass(frozen=True, kw_only=True)
class MissionSettings:
    """What a person chooses on the command line."""

    out: Path
    """Run folder to make."""
    world: int = 0
    level: Level = "guided"
    source: Source = "vision"
    plan: Sequence[str] = (plans.GRID,)
    """As in `plans.read`."""
    speed: Literal["max"] | float = "max"
    on_crash: Literal["end", "hold"] = "end"
    duration_s: float | None = None
    """Of the scene, whoever has ended; until all have or the horizon if None."""
    gcs: str | None = None
    """Ground station that may join, as in ``udp:127.0.0.1:14550``."""
    binary: Path | None = None
    parameters: Path | None = None
    """File of the firmware's, beside our own or instead of them."""

    def __post_init__(self) -> None:
        """Refuse what cannot be flown.

        Raises:
            ConfigError: naming the flag and its value.
        """
        if self.duration_s is not None and not 0.0 < self.duration_s < math.inf:
            raise ConfigError(f"--duration {self.duration_s:g}: give a number above 0")
        if self.speed != "max" and not 0.0 < self.speed < math.inf:
            raise ConfigError(f"--speed {self.speed:g}: give a number above 0, or max")
        if self.world < 0:
            raise ConfigError(f"--world {self.world}: give an index from 0 on")
        if self.level in STICK_LEVELS:
            raise ConfigError(
                f"--level {self.level}: robots are driven by hand there; "
                "use angler teleop --session sitl, or --level guided or thrusters"
            )


def run(
    scenario: Scenario, settings: MissionSettings, tell: Tell, display: Display
) -> tuple[MissionFlight, Run]:
    """Fly one world of a scenario.

    Args:
        scenario: whose world and robots.
        settings: how.
        tell: told what is going on until the robots move.
        display: shows how they stand from then on.

    Returns:
        How it went, and the run folder.

    Raises:
        ConfigError: something given cannot be used; nothing is left.
        RunError: the autopilots do not come up, and nothing is left; or one of them failed in
            flight, and the run folder holds what was flown until then.
    """
    count = len(scenario.members())
    if count > MOST_VEHICLES:  # at once, and not after a minute of compiling
        raise ConfigError(f"{count} robots: real autopilots can be 1 to {MOST_VEHICLES}")
    goals = plans.read(settings.plan, count)
    given = {} if settings.parameters is None else firmware.read(settings.parameters)
    binaries.find(settings.binary)
    with ExitStack() as stack:
        interrupt = stack.enter_context(breakable())
        station = None
        if settings.gcs is not None:
            station = stack.enter_context(GroundStation(settings.gcs))
        recording = stack.enter_context(
            SessionRecording(settings.out, scenario, settings.world, _inputs(settings))
        )
        tell(f"{scenario.name}: world {settings.world}, compiling, then booting {count} ArduSub")
        begun = time.perf_counter()
        session = stack.enter_context(_open(scenario, settings, given, recording.building))
        opened_s = time.perf_counter() - begun
        interrupt.check()
        autopilots = session.autopilots  # which a crash takes away from the session
        _say_ready(autopilots, tell)
        plans.check(session, goals)
        watchers: list[Watcher] = [recording]
        recording.begin(session)
        for robot, goal in goals.items():
            recording.plan(robot, plans.way(session, robot, goal))
        if station is not None:
            station.join(session)
            watchers.append(station)
        stop = stack.enter_context(stoppable())
        with display(session) as shown:
            flight = fly(
                session,
                duration_s=settings.duration_s or scenario.time.horizon_s,
                whole=settings.duration_s is not None,
                goals=goals,
                watchers=[*watchers, shown],
                stop=stop,
            )
        stop.closing = True
        kept = recording.close(
            RecordedCourse(
                steps=flight.steps,
                wall_s=flight.wall_s,
                compile_s=opened_s - autopilots.ready.wall_s,
                more={"sitl": _summary(autopilots, session.settings, settings.plan, flight, goals)},
                interrupted=flight.broken,
            )
        )
    return _result(flight, kept)


def _inputs(settings: MissionSettings) -> list[tuple[str, Path]]:
    """Files that a flight takes beside those of its scenario."""
    given = [("plan", Path(name)) for name in settings.plan if name != plans.GRID]
    if settings.parameters is not None:
        given.append(("parameters", settings.parameters))
    return given


def _open(
    scenario: Scenario, settings: MissionSettings, given: Mapping[str, float], building: Path
) -> SitlSession:
    return SitlSession(
        scenario,
        world=settings.world,
        level=settings.level,
        source=settings.source,
        speed=settings.speed,
        binary=settings.binary,
        folder=building / folder.ROBOTS,
        on_crash=settings.on_crash,
        parameters=given,
    )


def _say_ready(autopilots: Autopilots, tell: Tell) -> None:
    """How long it took, and which parameters the autopilots did not take."""
    ready = autopilots.ready
    tell(f"ready after {ready.sim_s:.1f} s of their clock, {ready.wall_s:.1f} s of ours")
    for name, found in autopilots.differences.items():
        for difference in found:
            tell(f"{name}: {difference}")


def _result(flight: MissionFlight, kept: Run | None) -> tuple[MissionFlight, Run]:
    """The run, unless one of the autopilots broke it off."""
    if kept is None:
        raise RunError(flight.broken or "not one step was flown")
    if flight.broken and not flight.by_signal:
        raise RunError(f"{flight.broken}\nwhat was flown until then is in {kept.path}")
    return flight, kept


def _version(autopilots: Autopilots, chosen: running.AutopilotSettings) -> str:
    """Return the version that the first autopilot stated, or else that of the program's record."""
    stated = autopilots.pilots[0].link.latest.get("AUTOPILOT_VERSION")
    return chosen.binary.version if stated is None else read_version(stated)[0]


def _summary(
    autopilots: Autopilots,
    chosen: running.AutopilotSettings,
    plan: Sequence[str],
    flight: MissionFlight,
    goals: dict[int, JointGoal],
) -> dict[str, Any]:
    """What only a run on real autopilots has."""
    names = [pilot.name for pilot in autopilots.pilots]
    return {
        "level": chosen.level,
        "source": chosen.source,
        "speed": chosen.speed,
        "plan": list(plan),
        "ardusub": {"version": _version(autopilots, chosen), "sha256": chosen.binary.sha256},
        "parameters": dict(chosen.parameters),
        "ready": {"sim_s": autopilots.ready.sim_s, "wall_s": autopilots.ready.wall_s},
        "steps": flight.steps,
        "scene_s": flight.scene_s,
        "real_time": flight.real_time,
        "lost": {names[i]: why for i, why in autopilots.lockstep.lost.items()},
        "trajectories": {names[i]: flight.last.status[i].note for i in goals},
    }
