"""Import of mission files: their scenario and plans, and a list of differences."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import jax
import numpy as np

from angler_mjx.errors import ConfigError
from angler_mjx.files import format_path, parse_model
from angler_mjx.frames import GeodeticOrigin, geodetic_to_local
from angler_mjx.planning.planner import MAX_POINTS, PathShape
from angler_mjx.report.interop.mission_files.build_goal import PlannedMission, build_goal
from angler_mjx.report.interop.mission_files.items import Mission
from angler_mjx.report.interop.mission_files.read_plan import read_plan
from angler_mjx.report.interop.mission_files.read_waypoints import read_waypoints
from angler_mjx.report.interop.mission_files.route import (
    Position,
    Stop,
    VehicleLimits,
    build_route,
)
from angler_mjx.robot.control.commands import joint_goal
from angler_mjx.robot.control.commands.joint_trajectory import VEHICLE_JOINTS
from angler_mjx.robot.importing.notes import Note, Notes
from angler_mjx.robot.importing.toml_text import format_tables
from angler_mjx.robot.vehicles import library
from angler_mjx.runs.simulator.host_planning import PlanNotes
from angler_mjx.runs.storage.plans.write import open_writer
from angler_mjx.scenario.fleet_entry import FleetEntry
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.sim.fleet import CRUISE_FRACTION
from angler_mjx.world.tasks.spec import MAX_JOBS

type MissionKind = Literal["plan", "tour"]
"""What a mission becomes: a plan with times, or a tour whose paths a planner finds."""

TOP_M = -0.5
"""Height of the highest position of a vehicle: all of it is in the water."""
_PARAMETERS: dict[str, tuple[str, float]] = {
    "WPNAV_SPEED": ("speed_mps", 0.01),
    "WPNAV_SPEED_UP": ("speed_up_mps", 0.01),
    "WPNAV_SPEED_DN": ("speed_down_mps", 0.01),
    "WPNAV_ACCEL": ("acceleration_mps2", 0.01),
    "WPNAV_ACCEL_Z": ("acceleration_z_mps2", 0.01),
    "WPNAV_JERK": ("jerk_mps3", 1.0),
    "WPNAV_RADIUS": ("radius_m", 0.01),
    "CIRCLE_RADIUS": ("circle_radius_m", 0.01),
    "CIRCLE_RATE": ("circle_rate_radps", math.pi / 180.0),
}
"""Firmware parameters that a mission depends on, with their units in ours."""
_MIN_CELL_M, _CELLS, _MAX_CELLS = 1.0, 40, 120
"""Cells along the longest horizontal edge; more only where cells are as small as they get."""
_TOUR_TOP_CELLS = 1.5
"""Depth of the highest position of a tour, in cells: planners keep out of the cells at the top."""
_MARGIN_M = 5.0
"""Free water around the mission."""
_HORIZON_FACTOR, _HORIZON_MARGIN_S, _MAX_HORIZON_S = 2.0, 60.0, 86_400.0
"""Horizon of the scenario beyond the plan: ArduSub waits for a vehicle that lags behind."""
_MIN_LIMIT = 1e-3
"""Smallest limit of speed, acceleration, jerk, radius or rate, in SI units."""
_HOME_TOLERANCE_M = 1.0
_MAX_NAME = 100
_START_GAP_M = 1.0
"""Free water between robots that start from one home."""


@dataclass(frozen=True, kw_only=True)
class ImportedMission:
    """Plan of the mission file of one robot."""

    mission: Mission
    start_m: Position
    route: tuple[Stop, ...]
    planned: PlannedMission


@dataclass(frozen=True, kw_only=True)
class ImportedFleet:
    """Scenario of the mission files of a fleet, and how it differs from them."""

    missions: tuple[ImportedMission, ...]
    """Of each robot."""
    origin: GeodeticOrigin
    """Of W."""
    scenario: Scenario
    text: str
    """TOML text of the scenario, with the notes as comments."""
    notes: tuple[Note, ...]


def read_mission(path: Path, notes: Notes) -> Mission:
    """Read a ``.plan`` or a way-point file, by its content.

    Raises:
        ConfigError: it is neither, or has a fault.
    """
    try:
        with path.open("rb") as file:
            head = file.read(64).lstrip(b"\xef\xbb\xbf \t\r\n")
    except OSError as error:
        raise ConfigError(f"{format_path(path)}: cannot be read ({error})") from error
    return read_plan(path, notes) if head.startswith(b"{") else read_waypoints(path)


def read_limits(parameters: dict[str, float], limits: VehicleLimits) -> VehicleLimits:
    """Return limits with the firmware parameters of a vehicle.

    Args:
        parameters: by name; others are ignored.
        limits: where a parameter is missing.

    Raises:
        ConfigError: a limit is not above 0.
    """
    values = {}
    for name, (field, scale) in _PARAMETERS.items():
        if name in parameters:
            # The sign of CIRCLE_RATE is a direction, which the item decides.
            value = (abs(parameters[name]) if name == "CIRCLE_RATE" else parameters[name]) * scale
            if value < _MIN_LIMIT:
                raise ConfigError(f"{name} = {parameters[name]:g}: too small to fly by")
            values[field] = value
    return replace(limits, **values)


def import_missions(
    paths: Sequence[Path],
    *,
    origin: GeodeticOrigin | None = None,
    kind: MissionKind = "plan",
    vehicle: str = "bluerov2_heavy",
    worlds: int = 1,
    limits: VehicleLimits | None = None,
) -> ImportedFleet:
    """Import the mission of each robot of a fleet.

    Args:
        paths: of the mission files, one for each robot.
        origin: position of W; the home of the first mission if left out.
        kind: what they become; a tour is one mission's.
        vehicle: name of a shipped vehicle, or path of a vehicle file; of all robots.
        worlds: number of worlds of the scenario.
        limits: of the firmware; ArduSub's defaults if left out.

    Raises:
        ConfigError: a fault of a file, or a mission that cannot be flown; names file and item.
    """
    if kind == "tour" and len(paths) > 1:
        raise ConfigError(
            f"--kind tour: {len(paths)} files; a fleet's tour has one list of positions: give one "
            "file, or --kind plan"
        )
    entry = parse_model(FleetEntry, {"vehicle": vehicle}, source="--vehicle")
    imported: list[ImportedMission] = []
    notes: list[Note] = []
    for path in paths:
        found = Notes()
        mission = read_mission(path, found)
        origin = locate_world(mission, origin, found)
        capable = limit_speed(limits or VehicleLimits(), entry, found)
        starts = [other.start_m for other in imported]
        imported.append(_plan_mission(mission, origin, capable, kind, starts, entry, found))
        of_file = f"{path.name}: " if len(paths) > 1 else ""
        notes += [replace(note, text=of_file + note.text) for note in found]
    assert origin is not None
    tables = _build_tables(imported, capable, kind, vehicle, worlds)
    names = ", ".join(path.name for path in paths)
    scenario = parse_model(Scenario, tables, source=f"{names} as a scenario")
    head = [
        f"# Mission {_one_line(names)}, imported by `angler mission import`.",
        f"# W is at latitude {origin.latitude_deg:.9g}, longitude {origin.longitude_deg:.9g}, "
        f"with the surface at {origin.altitude_m:g} m.",
        *(f"# {_one_line(str(note))}" for note in notes),
    ]
    return ImportedFleet(
        missions=tuple(imported),
        origin=origin,
        scenario=scenario,
        text="\n".join(head) + "\n\n" + format_tables(tables),
        notes=tuple(notes),
    )


def _plan_mission(
    mission: Mission,
    origin: GeodeticOrigin,
    limits: VehicleLimits,
    kind: MissionKind,
    starts_m: Sequence[Position],
    entry: FleetEntry,
    notes: Notes,
) -> ImportedMission:
    """Plan a mission from its home, apart from the starts of the robots before it."""
    top_m = TOP_M
    if kind == "tour":
        start = _start(mission, origin, TOP_M)
        stops = build_route(mission, origin, limits, Notes(), start_m=start, top_m=TOP_M)
        cell = _choose_cell(np.array([start, *(stop.position_m for stop in stops)]))
        top_m = -_TOUR_TOP_CELLS * cell
    home = _start(mission, origin, top_m)
    apart = round(2.0 * library.reach_m(library.load_vehicle(entry.vehicle)) + _START_GAP_M, 1)
    start = home
    while any(math.dist(start, other) < 0.99 * apart for other in starts_m):
        start = (round(start[0] + apart, 6), *start[1:])
    where = "" if mission.home is None else ", below home"
    if start != home:
        where = f", {start[0] - home[0]:.1f} m east of where another one starts"
    notes.add(
        "assumed",
        f"the vehicle starts at rest at ({start[0]:.1f}, {start[1]:.1f}, {start[2]:.1f}) m{where}",
    )
    route = build_route(mission, origin, limits, notes, start_m=start, top_m=top_m)
    goal = route[-1].position_m
    planned = build_goal(
        route,
        limits,
        start_m=start,
        start_yaw_rad=math.atan2(goal[1] - start[1], goal[0] - start[0]),
    )
    if len(planned.goal.points) > MAX_POINTS:
        raise ConfigError(
            f"{format_path(mission.file)}: takes a plan of {len(planned.goal.points)} points, "
            f"{MAX_POINTS} are the most; divide the mission"
        )
    if kind == "tour":
        _note_tour(route, notes)
    return ImportedMission(mission=mission, start_m=start, route=route, planned=planned)


def write_plans(path: Path, imported: ImportedFleet) -> None:
    """Write the plans of missions as a file of plans, the same for all worlds.

    Args:
        path: of the Zarr group; must not exist.
        imported: the missions.

    Raises:
        ConfigError: the path exists.
        RunError: it cannot be written.
    """
    scenario = imported.scenario
    goals = [mission.planned.goal for mission in imported.missions]
    size = max(len(goal.points) for goal in goals)
    trajectories = [
        joint_goal.build_trajectory(
            goal, joints=VEHICLE_JOINTS, position=goal.points[0].positions, size=size
        )
        for goal in goals
    ]
    worlds, robots = scenario.worlds, len(goals)
    fleet = jax.tree.map(lambda *leaves: np.stack([np.asarray(x) for x in leaves]), *trajectories)
    paths = replace(
        jax.tree.map(lambda leaf: np.broadcast_to(leaf, (worlds, *np.shape(leaf))), fleet),
        found=np.ones((worlds, robots), bool),
    )
    shape = PathShape(points=paths.time_s.shape[-1], joints=True)
    writer = open_writer(path, scenario, shape, resume=False, tile=worlds)
    with writer.keeping():
        none = np.full((worlds, robots), "", object)
        notes = PlanNotes(planning_s=np.zeros(worlds), status=none[:, 0], reason=none)
        writer.write(0, paths, notes)
        writer.publish()


def locate_world(mission: Mission, origin: GeodeticOrigin | None, notes: Notes) -> GeodeticOrigin:
    """Return the position of W: the origin, or the mission's home.

    Raises:
        ConfigError: there is neither.
    """
    home = mission.home
    if origin is None:
        if home is None:
            raise ConfigError(
                f"{format_path(mission.file)}: has no home; give --origin LATITUDE,LONGITUDE"
            )
        notes.add(
            "assumed",
            f"W is at home, with the surface at home's {home.altitude_m:g} m; --origin changes it",
        )
        return home
    if home is not None:
        x, y = geodetic_to_local(origin, home.latitude_deg, home.longitude_deg)
        if math.hypot(x, y) > _HOME_TOLERANCE_M:
            notes.add("converted", f"home is at ({x:.1f}, {y:.1f}) m of W")
    return origin


def _start(mission: Mission, origin: GeodeticOrigin, top_m: float) -> Position:
    home = mission.home or origin
    x, y = geodetic_to_local(origin, home.latitude_deg, home.longitude_deg)
    return round(x, 6), round(y, 6), top_m


def limit_speed(limits: VehicleLimits, entry: FleetEntry, notes: Notes) -> VehicleLimits:
    """Return the limits with the fastest cruise of a vehicle.

    Args:
        limits: of the firmware.
        entry: robots of a fleet.
        notes: receives a note where the vehicle is slower.
    """
    drives = entry.drive_limits()
    surge, _, heave = (
        CRUISE_FRACTION * min(float(drive.terminal_speed_mps[i]) for drive in drives)
        for i in range(3)
    )
    surge = min(surge, FleetEntry.model_fields["cruise_speed_mps"].metadata[1].le)
    if limits.speed_mps > surge:
        notes.add(
            "snapped", f"speed {limits.speed_mps:g} m/s (WPNAV_SPEED) to the vehicle's {surge:.3g}"
        )
    return replace(
        limits,
        max_speed_mps=surge,
        speed_up_mps=min(limits.speed_up_mps, heave),
        speed_down_mps=min(limits.speed_down_mps, heave),
    )


def _note_tour(route: Sequence[Stop], notes: Notes) -> None:
    if len(route) > MAX_JOBS:
        raise route[MAX_JOBS].item.location.fault(
            f": a tour has at most {MAX_JOBS} positions; take --kind plan, or divide the mission"
        )
    for stop in route:
        if stop.hold_s:
            notes.add("dropped", f"{stop.item.name}: tours do not wait", stop.item.location)
        if stop.circle is not None:
            notes.add("dropped", f"{stop.item.name}: tours do not circle", stop.item.location)
        if stop.yaw_rad is not None:
            notes.add("dropped", f"{stop.item.name}: tours set no headings", stop.item.location)
    if len({stop.speed_mps for stop in route}) > 1:
        notes.add("dropped", "changes of speed: tours have one, the fastest")


def _build_tables(
    missions: Sequence[ImportedMission],
    limits: VehicleLimits,
    kind: MissionKind,
    vehicle: str,
    worlds: int,
) -> dict[str, Any]:
    points = np.array(
        [
            position
            for mission in missions
            for position in (
                mission.start_m,
                *(point.positions[:3] for point in mission.planned.goal.points),
            )
        ]
    )
    cell = _choose_cell(points)
    extent, depth = _measure_extent(points)
    shape = [max(4, 2 * math.ceil(edge / cell)) for edge in extent]
    longest = max(missions, key=lambda mission: mission.planned.duration_s)
    horizon = math.ceil(_HORIZON_FACTOR * longest.planned.duration_s + _HORIZON_MARGIN_S)
    if horizon > _MAX_HORIZON_S:
        raise ConfigError(
            f"{format_path(longest.mission.file)}: takes {longest.planned.duration_s:.0f} s; a "
            f"scenario has {_MAX_HORIZON_S:g} s at most: shorten its holds, or divide it"
        )
    names = ", ".join(_one_line(mission.mission.file.name) for mission in missions)
    tables: dict[str, Any] = {
        "schema_version": 1,
        "name": "_".join(_name(mission.mission.file) for mission in missions)[:_MAX_NAME],
        "description": f"Mission {names}",
        "worlds": worlds,
        "seed": 1,
        "time": {"horizon_s": float(horizon)},
        "world": {
            "preset": "open",
            "shape": [*shape, max(4, math.ceil(depth / cell))],
            "cell_m": round(cell, 3) if cell > _MIN_CELL_M else _MIN_CELL_M,
            "depth_m": 0.0,
            "placement": "given",
            "start_m": [list(mission.start_m) for mission in missions],
            "goal_m": [[round(x, 6) for x in mission.route[-1].position_m] for mission in missions],
        },
        "fleet": [
            {"vehicle": vehicle, "cruise_speed_mps": _find_speed(mission, kind)}
            for mission in missions
        ],
    }
    if kind == "tour":
        tables["task"] = {
            "type": "tour",
            "positions_m": [[round(x, 6) for x in stop.position_m] for stop in missions[0].route],
            "shared": False,
            "ordered": True,
            "tolerance_m": limits.radius_m,
        }
    return tables


def _find_speed(mission: ImportedMission, kind: MissionKind) -> float:
    """Return the cruise speed of a mission, rounded up: faster paths are refused, m/s."""
    fastest = mission.planned.max_speed_mps
    speed = fastest if kind == "plan" else max(stop.speed_mps for stop in mission.route)
    return math.ceil(1e4 * max(speed, 0.05)) / 1e4


def _measure_extent(points: np.ndarray) -> tuple[np.ndarray, float]:
    """Return half the edges [2] of the water around points [n, 3], and its depth, m."""
    extent: np.ndarray = np.abs(points[:, :2]).max(axis=0) + _MARGIN_M
    return extent, -float(points[:, 2].min()) + _MARGIN_M


def _choose_cell(points: np.ndarray) -> float:
    """Return the edge length of the cells of a grid around points [n, 3], m."""
    extent, depth = _measure_extent(points)
    return max(_MIN_CELL_M, float(extent.max()) * 2.0 / _CELLS, depth / _MAX_CELLS)


def _name(file: Path) -> str:
    letters = "".join(c if c.isalnum() and c.isascii() else "_" for c in file.stem.lower())
    return letters.strip("_") or "mission"


def _one_line(text: str) -> str:
    return "".join(char if char.isprintable() else " " for char in text)
