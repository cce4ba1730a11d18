"""Missions that the firmware flies in AUTO: their upload, and the plan of the same mission."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

from angler_mjx.errors import ConfigError
from angler_mjx.frames import GeodeticOrigin
from angler_mjx.report.interop.mission_files import items as mav
from angler_mjx.report.interop.mission_files.build_goal import PlannedMission, build_goal
from angler_mjx.report.interop.mission_files.import_mission import (
    TOP_M,
    limit_speed,
    locate_world,
    read_limits,
    read_mission,
)
from angler_mjx.report.interop.mission_files.items import Mission, MissionItem
from angler_mjx.report.interop.mission_files.route import (
    Position,
    Stop,
    VehicleLimits,
    build_route,
    unroll_jumps,
)
from angler_mjx.robot.importing.notes import Note, Notes
from angler_mjx.scenario.fleet_entry import FleetEntry
from angler_sitl.autopilots.boot import WorldOrigin
from angler_sitl.wire.mission_upload import UploadItem

_ORIGIN_TOLERANCE_DEG = 1e-7
_NAVIGATING = (
    mav.WAYPOINT,
    mav.SPLINE_WAYPOINT,
    mav.LOITER_UNLIMITED,
    mav.LOITER_TURNS,
    mav.LOITER_TIME,
    mav.RETURN_TO_LAUNCH,
    mav.LAND,
    mav.DELAY,
)


@dataclass(frozen=True, kw_only=True)
class FirmwareMission:
    """Mission of one robot, ready to be uploaded."""

    mission: Mission
    origin: GeodeticOrigin
    """Of W."""
    limits: VehicleLimits
    """Of the firmware, and of the vehicle."""
    notes: tuple[Note, ...]

    @cached_property
    def order(self) -> tuple[MissionItem, ...]:
        """Items in the order in which they act; one without an end is the last."""
        order = unroll_jumps(self.mission)
        ends = [i for i, item in enumerate(order, 1) if item.command == mav.LOITER_UNLIMITED]
        return tuple(order[: ends[0]] if ends else order)

    @property
    def moves(self) -> int:
        """Number of items in `order` that move the vehicle."""
        return sum(item.command in _NAVIGATING for item in self.order)

    def count_moves(self, reached: Iterable[int]) -> int:
        """Return how many items that move the vehicle are completed.

        Args:
            reached: numbers of items that the firmware reported as completed, in order. Of items
                that it completes at once it reports the last alone.
        """
        done = 0
        for number in reached:
            later = (i for i in range(done, len(self.order)) if self.order[i].number == number)
            done = next(later, done - 1) + 1
        return sum(item.command in _NAVIGATING for item in self.order[:done])

    @property
    def parameters(self) -> dict[str, float]:
        """Firmware parameters of the mission: no faster than the vehicle."""
        limits = self.limits
        speeds = {
            "WPNAV_SPEED": min(limits.speed_mps, limits.max_speed_mps),
            "WPNAV_SPEED_UP": limits.speed_up_mps,
            "WPNAV_SPEED_DN": limits.speed_down_mps,
        }
        return {name: round(100.0 * speed, 3) for name, speed in speeds.items()}

    @property
    def home(self) -> WorldOrigin:
        """W's origin, as the autopilots take it."""
        return WorldOrigin(lat_deg=self.origin.latitude_deg, lon_deg=self.origin.longitude_deg)


def load_missions(
    files: Sequence[Path],
    entries: Sequence[FleetEntry],
    origin: GeodeticOrigin | None,
    parameters: Mapping[str, float],
) -> tuple[FirmwareMission, ...]:
    """Read the mission of each robot.

    Args:
        files: one for each robot.
        entries: of each robot.
        origin: of W; the home of the missions if left out.
        parameters: firmware parameters that the user sets.

    Raises:
        ConfigError: a mission cannot be flown, or the files are not as many as robots, or they
            have different homes.
    """
    if len(files) != len(entries):
        raise ConfigError(
            f"--mission: {len(files)} files for {len(entries)} robots; give one for each, or fewer "
            "robots with --robots"
        )
    missions = []
    for file, entry in zip(files, entries, strict=True):
        notes = Notes()
        mission = read_mission(file, notes)
        located = locate_world(mission, origin, notes)
        limits = limit_speed(read_limits(dict(parameters), VehicleLimits()), entry, notes)
        # The start does not matter for faults; the plan is made when it is there.
        start = (0.0, 0.0, TOP_M)
        route = build_route(mission, located, limits, notes, start_m=start, top_m=TOP_M)
        for stop in route:
            if stop.item.command == mav.RETURN_TO_LAUNCH:
                notes.add(
                    "converted",
                    f"{stop.item.name}: uploaded as a way-point, which ArduSub 4.6 flies",
                    stop.item.location,
                )
        missions.append(
            FirmwareMission(mission=mission, origin=located, limits=limits, notes=tuple(notes))
        )
    first = missions[0].origin
    for file, other in zip(files, missions, strict=True):
        apart = max(
            abs(other.origin.latitude_deg - first.latitude_deg),
            abs(other.origin.longitude_deg - first.longitude_deg),
        )
        if apart > _ORIGIN_TOLERANCE_DEG:
            raise ConfigError(
                f"--mission {file}: its home is not that of {files[0]}; give --origin"
            )
    return tuple(missions)


def merge_parameters(missions: Sequence[FirmwareMission]) -> dict[str, float]:
    """Return the firmware parameters of several missions: those of the slowest robot."""
    tables = [mission.parameters for mission in missions]
    return {name: min(table[name] for table in tables) for name in tables[0]}


def build_upload(mission: FirmwareMission) -> tuple[UploadItem, ...]:
    """Return the items to upload, home first; altitudes become relative to the surface."""
    origin = mission.origin
    home = _build_waypoint(origin, mav.SEA_LEVEL_FRAMES[0], 0.0)
    return (home, *(_build_item(item, mission) for item in mission.mission.items))


def plan_mission(
    mission: FirmwareMission,
    parameters: Mapping[str, float],
    *,
    start_m: Position,
    start_yaw_rad: float,
) -> tuple[tuple[Stop, ...], PlannedMission]:
    """Return the stops and the plan of the mission that the firmware flies.

    Args:
        mission: that was uploaded.
        parameters: of the firmware, read back.
        start_m: position of the vehicle.
        start_yaw_rad: its heading.
    """
    limits = mission.limits
    flown = replace(read_limits(dict(parameters), limits), max_speed_mps=limits.max_speed_mps)
    route = build_route(
        mission.mission, mission.origin, flown, Notes(), start_m=start_m, top_m=TOP_M
    )
    return route, build_goal(route, flown, start_m=start_m, start_yaw_rad=start_yaw_rad)


def _build_waypoint(position: GeodeticOrigin, frame: int, altitude_m: float) -> UploadItem:
    return UploadItem(
        command=mav.WAYPOINT,
        frame=frame,
        parameters=(0.0, 0.0, 0.0, 0.0),
        latitude_deg=position.latitude_deg,
        longitude_deg=position.longitude_deg,
        altitude_m=altitude_m,
    )


def _build_item(item: MissionItem, mission: FirmwareMission) -> UploadItem:
    if item.command == mav.RETURN_TO_LAUNCH:  # refused by ArduSub 4.6 in AUTO: "Bad alt frame"
        home = mission.mission.home or mission.origin
        return _build_waypoint(home, mav.RELATIVE_FRAME, TOP_M)
    p1, p2, p3, p4 = (value or 0.0 for value in item.parameters)
    frame, altitude = item.frame, item.altitude_m or 0.0
    if frame in mav.SEA_LEVEL_FRAMES and altitude and item.command in _NAVIGATING:
        frame, altitude = mav.RELATIVE_FRAME, altitude - mission.origin.altitude_m
    if item.command == mav.CHANGE_SPEED and p2 > mission.limits.max_speed_mps:
        p2 = mission.limits.max_speed_mps
    return UploadItem(
        command=item.command,
        frame=frame,
        parameters=(p1, p2, p3, p4) if all(map(math.isfinite, (p1, p2, p3, p4))) else (0.0,) * 4,
        latitude_deg=item.latitude_deg or 0.0,
        longitude_deg=item.longitude_deg or 0.0,
        altitude_m=altitude,
    )
