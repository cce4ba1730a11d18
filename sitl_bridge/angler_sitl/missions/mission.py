"""Mission of a scenario on real autopilots: checked, booted, flown, and recorded."""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np

from angler_kernels import quaternion
from angler_mjx.errors import ConfigError, RunError
from angler_mjx.files import JsonTable
from angler_mjx.frames import GeodeticOrigin
from angler_mjx.planning.planner import MAX_POINTS
from angler_mjx.report.interop import joint_trajectory_file
from angler_mjx.robot.control.commands import joint_goal
from angler_mjx.robot.control.commands.joint_goal import JointGoal
from angler_mjx.robot.control.commands.joint_trajectory import VEHICLE_JOINTS, sample_state
from angler_mjx.runs.session.interface import Session
from angler_mjx.runs.session.online_policy import OnlineFlyer
from angler_mjx.runs.session.recording import FlownPath, RecordedCourse, SessionRecording
from angler_mjx.runs.storage import folder
from angler_mjx.runs.storage.folder import Run
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.teleop.loop import Watcher
from angler_mjx.teleop.signals import break_on_signal, stop_on_signal
from angler_sitl.autopilots import autopilots as running
from angler_sitl.autopilots.autopilots import Autopilots
from angler_sitl.firmware import binary as binaries
from angler_sitl.firmware import parameters as firmware
from angler_sitl.firmware.parameters import CommandLevel, PositionSource
from angler_sitl.firmware.probe import read_version
from angler_sitl.missions.auto_flight import AutoFlight
from angler_sitl.missions.firmware_mission import (
    FirmwareMission,
    build_upload,
    load_missions,
    merge_parameters,
)
from angler_sitl.missions.flight import MissionFlight, fly_mission
from angler_sitl.missions.ground_station import GroundStation
from angler_sitl.missions.mission_gap import lift_tolerances
from angler_sitl.session import SitlSession
from angler_sitl.steering.levels import STICK_LEVELS
from angler_sitl.wire.ports import MAX_VEHICLES

GRID = "grid"
"""Source of plans: the paths of the planner."""
PATH_POINTS = 256
"""Number of points of a rendered path."""

type ReportText = Callable[[str], None]
"""Receiver of progress messages."""
type WatcherFactory = Callable[[SitlSession], AbstractContextManager[Watcher]]
"""Factory of the display of the robots' status."""


@dataclass(frozen=True, kw_only=True)
class MissionSettings:
    """Mission settings from the command line."""

    out: Path
    """Run folder to create."""
    world: int = 0
    level: CommandLevel = "guided"
    source: PositionSource = "vision"
    plan: Sequence[str] = (GRID,)
    """Sources of the plans, as in `load_trajectories`."""
    speed: Literal["max"] | float = "max"
    on_crash: Literal["end", "hold"] = "end"
    duration_s: float | None = None
    """Fixed duration of the scene; if None, until all robots have ended or the horizon."""
    gcs: str | None = None
    """Ground station that may join, as in ``udp:127.0.0.1:14550``."""
    binary: Path | None = None
    parameters: Path | None = None
    """File of firmware parameters that extend or override the defaults."""
    missions: Sequence[Path] = ()
    """Mission files, one for each robot, that the firmware flies in AUTO; none if empty."""
    origin: GeodeticOrigin | None = None
    """Position of W's origin for missions; their home if left out."""

    def __post_init__(self) -> None:
        """Refuse settings that cannot be flown.

        Raises:
            ConfigError: naming the flag and its value.
        """
        if self.duration_s is not None and not 0.0 < self.duration_s < math.inf:
            raise ConfigError(f"--duration {self.duration_s:g}: give a number above 0")
        if self.speed != "max" and not 0.0 < self.speed < math.inf:
            raise ConfigError(f"--speed {self.speed:g}: give a number above 0, or max")
        if self.world < 0:
            raise ConfigError(f"--world {self.world}: give an index from 0 on")
        if self.missions and (list(self.plan) != [GRID] or self.level != "guided"):
            flag = "--plan" if list(self.plan) != [GRID] else f"--level {self.level}"
            raise ConfigError(
                f"{flag}: --mission is flown by ArduSub in AUTO; leave out one of them"
            )
        if self.origin is not None and not self.missions:
            raise ConfigError("--origin: is of missions; give --mission, or leave it out")
        if self.level in STICK_LEVELS:
            raise ConfigError(
                f"--level {self.level}: robots are driven by hand there; "
                "use angler teleop --session sitl, or --level guided or thrusters"
            )


def run_mission(
    scenario: Scenario, settings: MissionSettings, report: ReportText, display: WatcherFactory
) -> tuple[MissionFlight, Run]:
    """Fly one world of a scenario.

    Args:
        scenario: source of the world and robots.
        settings: of the mission.
        report: receives progress messages until the robots move.
        display: shows the robots' status from then on.

    Returns:
        Result of the flight, and the run folder.

    Raises:
        ConfigError: an input cannot be used; nothing is left.
        RunError: the autopilots do not come up, and nothing is left; or an autopilot failed in
            flight, and the run folder holds the flight until then.
    """
    count = len(scenario.members())
    if count > MAX_VEHICLES:  # before compiling, which takes a minute
        raise ConfigError(f"{count} robots: real autopilots can be 1 to {MAX_VEHICLES}")
    goals = load_trajectories(settings.plan, count)
    firmware_parameters = (
        {} if settings.parameters is None else firmware.read_parameters(settings.parameters)
    )
    missions: tuple[FirmwareMission, ...] = ()
    if settings.missions:
        entries = [entry for entry in scenario.fleet for _ in range(entry.count)]
        missions = load_missions(settings.missions, entries, settings.origin, firmware_parameters)
        for note in dict.fromkeys(str(note) for mission in missions for note in mission.notes):
            report(note)
        # What the user sets counts; all robots fly with the parameters of the slowest.
        firmware_parameters = {**merge_parameters(missions), **firmware_parameters}
    binaries.find_binary(settings.binary)
    with ExitStack() as stack:
        interrupt = stack.enter_context(break_on_signal())
        station = None
        if settings.gcs is not None:
            station = stack.enter_context(GroundStation(settings.gcs))
        recording = stack.enter_context(
            SessionRecording(settings.out, scenario, settings.world, _list_inputs(settings))
        )
        report(f"{scenario.name}: world {settings.world}, compiling, then booting {count} ArduSub")
        start_s = time.perf_counter()
        session = stack.enter_context(
            _open_session(scenario, settings, firmware_parameters, recording.building, missions)
        )
        # Plans lead the base to the goal; the policy of such a task brings the end effector there.
        policy = OnlineFlyer(session, report=report) if scenario.by_end_effector else None
        opened_s = time.perf_counter() - start_s
        interrupt.check()
        autopilots = session.autopilots  # a crash removes them from the session
        _report_ready(autopilots, report)
        auto = None
        if missions:
            auto = AutoFlight(session, missions)
            goals = auto.goals
        check_goals(session, goals)
        watchers: list[Watcher] = [recording]
        recording.begin(session)
        for robot, goal in goals.items():
            recording.plan(robot, sample_path(session, robot, goal))
        if station is not None:
            station.join(session)
            watchers.append(station)
        if auto is not None:
            watchers.append(auto)
            auto.begin()
        stop = stack.enter_context(stop_on_signal())
        with display(session) as display_watcher:
            flight = fly_mission(
                session,
                duration_s=settings.duration_s or scenario.time.horizon_s,
                whole=settings.duration_s is not None,
                goals=goals,
                policy=policy,
                has_completed=None if auto is None else auto.has_completed,
                watchers=[*watchers, display_watcher],
                stop=stop,
            )
        stop.closing = True
        gaps: JsonTable = {}
        if auto is not None and not flight.broken:
            report("the batch simulator flies the plan of the mission")
            gaps = {"mission": auto.measure_gaps(scenario, settings.world, flight.scene_s, report)}
        stored_run = recording.close(
            RecordedCourse(
                steps=flight.steps,
                wall_s=flight.wall_s,
                compile_s=opened_s - autopilots.ready.wall_s,
                more={
                    "sitl": {
                        **_summarise_run(
                            autopilots, session.settings, settings.plan, flight, goals
                        ),
                        **gaps,
                    }
                },
                interrupted=flight.broken,
            )
        )
    return _check_result(flight, stored_run)


def _list_inputs(settings: MissionSettings) -> list[tuple[str, Path]]:
    """Return the input files of a flight beside those of its scenario."""
    files = [("plan", Path(name)) for name in settings.plan if name != GRID]
    files += [("mission", path) for path in settings.missions]
    if settings.parameters is not None:
        files.append(("parameters", settings.parameters))
    return files


def _open_session(
    scenario: Scenario,
    settings: MissionSettings,
    firmware_parameters: Mapping[str, float],
    building: Path,
    missions: Sequence[FirmwareMission] = (),
) -> SitlSession:
    of_missions: dict[str, Any] = {}
    if missions:
        of_missions = {
            "home": missions[0].home,
            "missions": [build_upload(mission) for mission in missions],
            "points": MAX_POINTS,
            "tolerances": lift_tolerances(),
            "start_tolerance": 0.0,
        }
    return SitlSession(
        scenario,
        world=settings.world,
        level=settings.level,
        source=settings.source,
        speed=settings.speed,
        binary=settings.binary,
        folder=building / folder.ROBOTS,
        on_crash=settings.on_crash,
        parameters=firmware_parameters,
        **of_missions,
    )


def _report_ready(autopilots: Autopilots, report: ReportText) -> None:
    """Report the start-up time and the parameters that the autopilots did not accept."""
    ready = autopilots.ready
    report(f"ready after {ready.sim_s:.1f} s of their clock, {ready.wall_s:.1f} s of ours")
    for name, differences in autopilots.differences.items():
        for difference in differences:
            report(f"{name}: {difference}")


def _check_result(flight: MissionFlight, stored_run: Run | None) -> tuple[MissionFlight, Run]:
    """Return the flight and its run, or raise if an autopilot broke it off."""
    if stored_run is None:
        raise RunError(flight.broken or "not one step was flown")
    if flight.broken and not flight.by_signal:
        raise RunError(f"{flight.broken}\nwhat was flown until then is in {stored_run.path}")
    return flight, stored_run


def _get_version(autopilots: Autopilots, chosen: running.AutopilotSettings) -> str:
    """Return the version stated by the first autopilot, or else that of the program's record."""
    stated = autopilots.pilots[0].link.latest.get("AUTOPILOT_VERSION")
    return chosen.binary.version if stated is None else read_version(stated)[0]


def _summarise_run(
    autopilots: Autopilots,
    chosen: running.AutopilotSettings,
    plan: Sequence[str],
    flight: MissionFlight,
    goals: dict[int, JointGoal],
) -> JsonTable:
    """Return the summary entries specific to a run on real autopilots."""
    names = [pilot.name for pilot in autopilots.pilots]
    return {
        "level": chosen.level,
        "source": chosen.source,
        "speed": chosen.speed,
        "plan": list(plan),
        "ardusub": {"version": _get_version(autopilots, chosen), "sha256": chosen.binary.sha256},
        "parameters": dict(chosen.parameters),
        "ready": {"sim_s": autopilots.ready.sim_s, "wall_s": autopilots.ready.wall_s},
        "steps": flight.steps,
        "scene_s": flight.scene_s,
        "real_time": flight.real_time,
        "lost": {names[i]: why for i, why in autopilots.lost.items()},
        "trajectories": {names[i]: flight.last.status[i].note for i in goals},
    }


def load_trajectories(sources: Sequence[str], robots: int) -> dict[int, JointGoal]:
    """Return JointTrajectories by robot index; empty where the planner's paths are flown.

    Args:
        sources: ``grid``, or files as `angler_mjx.report.interop` writes them: one with all robots,
            or several. Robots in none of the files follow the planner's path.
        robots: number of robots.

    Raises:
        ConfigError: a file cannot be used, or a robot is in two of them.
    """
    if list(sources) == [GRID]:
        return {}
    goals: dict[int, JointGoal] = {}
    for name in sources:
        if name == GRID:
            raise ConfigError("--plan grid: give it alone, or files alone")
        more = joint_trajectory_file.read_trajectories(Path(name), robots=robots)
        if duplicates := sorted(goals.keys() & more.keys()):
            raise ConfigError(f"--plan {name}: robot {duplicates[0]} is in an earlier file already")
        goals.update(more)
    return goals


def sample_path(session: Session, robot: int, goal: JointGoal) -> FlownPath:
    """Return the path of a trajectory from the robot's position, with many points."""
    observation = session.observe()
    p, q = (np.asarray(part)[robot] for part in (observation.estimate.p, observation.estimate.q))
    start = [*p.tolist(), float(quaternion.yaw(q))]
    trajectory = joint_goal.build_trajectory(goal, joints=VEHICLE_JOINTS, position=start)
    times = np.linspace(0.0, float(trajectory.time_s[-1]), PATH_POINTS)
    points = np.asarray(jax.vmap(sample_state, (None, 0))(trajectory, jnp.asarray(times)).position)
    return FlownPath(time_s=goal.stamp_s + times, position_m=points[:, :3], yaw_rad=points[:, 3])


def check_goals(session: Session, goals: dict[int, JointGoal]) -> None:
    """Refuse trajectories that robots cannot follow from their positions.

    Raises:
        ConfigError: one message with the faults of all trajectories.
    """
    faults = []
    for robot, goal in goals.items():
        try:
            session.check(robot, goal)
        except ConfigError as error:
            faults.append(str(error))
    if faults:
        raise ConfigError("\n".join(["--plan: cannot be flown", *faults]))
