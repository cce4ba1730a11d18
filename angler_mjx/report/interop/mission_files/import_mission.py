"""Import of a mission file: its scenario and its plan, and a list of differences."""

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


@dataclass(frozen=True, kw_only=True)
class ImportedMission:
    """Scenario and plan of a mission file, and how they differ from it."""

    mission: Mission
    origin: GeodeticOrigin
    """Of W."""
    scenario: Scenario
    text: str
    """TOML text of the scenario, with the notes as comments."""
    notes: tuple[Note, ...]
    route: tuple[Stop, ...]
    planned: PlannedMission


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


def import_mission(
    path: Path,
    *,
    origin: GeodeticOrigin | None = None,
    kind: MissionKind = "plan",
    vehicle: str = "bluerov2_heavy",
    worlds: int = 1,
    limits: VehicleLimits | None = None,
) -> ImportedMission:
    """Import a mission.

    Args:
        path: of the mission file.
        origin: position of W; the mission's home if left out.
        kind: what it becomes.
        vehicle: name of a shipped vehicle, or path of a vehicle file.
        worlds: number of worlds of the scenario.
        limits: of the firmware; ArduSub's defaults if left out.

    Raises:
        ConfigError: a fault of the file, or a mission that cannot be flown; names file and item.
    """
    notes = Notes()
    mission = read_mission(path, notes)
    located = locate_world(mission, origin, notes)
    entry = parse_model(FleetEntry, {"vehicle": vehicle}, source="--vehicle")
    capable = limit_speed(limits or VehicleLimits(), entry, notes)
    top_m = TOP_M
    if kind == "tour":
        start = _start(mission, located, TOP_M)
        stops = build_route(mission, located, capable, Notes(), start_m=start, top_m=TOP_M)
        cell = _choose_cell(np.array([start, *(stop.position_m for stop in stops)]))
        top_m = -_TOUR_TOP_CELLS * cell
    start = _start(mission, located, top_m)
    notes.add(
        "assumed",
        f"the vehicle starts at rest at ({start[0]:.1f}, {start[1]:.1f}, {start[2]:.1f}) m"
        + ("" if mission.home is None else ", below home"),
    )
    route = build_route(mission, located, capable, notes, start_m=start, top_m=top_m)
    goal = route[-1].position_m
    planned = build_goal(
        route,
        capable,
        start_m=start,
        start_yaw_rad=math.atan2(goal[1] - start[1], goal[0] - start[0]),
    )
    if len(planned.goal.points) > MAX_POINTS:
        raise ConfigError(
            f"{format_path(path)}: takes a plan of {len(planned.goal.points)} points, {MAX_POINTS} "
            "are the most; divide the mission"
        )
    if kind == "tour":
        _note_tour(route, notes)
    tables = _build_tables(mission, route, planned, capable, kind, vehicle, worlds, start)
    listed = tuple(notes)
    scenario = parse_model(
        Scenario,
        tables,
        source=f"{path} as a scenario",
    )
    head = [f"# Mission {path.name}, imported by `angler mission import`."]
    head.append(
        f"# W is at latitude {located.latitude_deg:.9g}, longitude {located.longitude_deg:.9g}, "
        f"with the surface at {located.altitude_m:g} m."
    )
    head += [f"# {_one_line(str(note))}" for note in listed]
    text = "\n".join(head) + "\n\n" + format_tables(tables)
    return ImportedMission(
        mission=mission,
        origin=located,
        scenario=scenario,
        text=text,
        notes=listed,
        route=route,
        planned=planned,
    )


def write_plans(path: Path, imported: ImportedMission) -> None:
    """Write the plan of a mission as a file of plans, the same for all worlds.

    Args:
        path: of the Zarr group; must not exist.
        imported: the mission.

    Raises:
        ConfigError: the path exists.
        RunError: it cannot be written.
    """
    scenario, goal = imported.scenario, imported.planned.goal
    trajectory = joint_goal.build_trajectory(
        goal, joints=VEHICLE_JOINTS, position=goal.points[0].positions
    )
    worlds = scenario.worlds
    paths = replace(
        jax.tree.map(
            lambda leaf: np.broadcast_to(np.asarray(leaf), (worlds, 1, *np.shape(leaf))),
            trajectory,
        ),
        found=np.ones((worlds, 1), bool),
    )
    shape = PathShape(points=paths.time_s.shape[-1], joints=True)
    writer = open_writer(path, scenario, shape, resume=False, tile=worlds)
    with writer.keeping():
        none = np.full((worlds, 1), "", object)
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
    mission: Mission,
    route: Sequence[Stop],
    planned: PlannedMission,
    limits: VehicleLimits,
    kind: MissionKind,
    vehicle: str,
    worlds: int,
    start: Position,
) -> dict[str, Any]:
    points = np.array([start, *(p.positions[:3] for p in planned.goal.points)])
    cell = _choose_cell(points)
    extent, depth = _measure_extent(points)
    shape = [max(4, 2 * math.ceil(edge / cell)) for edge in extent]
    horizon = math.ceil(_HORIZON_FACTOR * planned.duration_s + _HORIZON_MARGIN_S)
    if horizon > _MAX_HORIZON_S:
        raise ConfigError(
            f"{format_path(mission.file)}: takes {planned.duration_s:.0f} s; a scenario has "
            f"{_MAX_HORIZON_S:g} s at most: shorten its holds, or divide it"
        )
    speed = planned.max_speed_mps if kind == "plan" else max(stop.speed_mps for stop in route)
    tables: dict[str, Any] = {
        "schema_version": 1,
        "name": _name(mission.file),
        "description": f"Mission {_one_line(mission.file.name)}",
        "worlds": worlds,
        "seed": 1,
        "time": {"horizon_s": float(horizon)},
        "world": {
            "preset": "open",
            "shape": [*shape, max(4, math.ceil(depth / cell))],
            "cell_m": round(cell, 3) if cell > _MIN_CELL_M else _MIN_CELL_M,
            "depth_m": 0.0,
            "placement": "given",
            "start_m": [list(start)],
            "goal_m": [[round(x, 6) for x in route[-1].position_m]],
        },
        "fleet": [
            {
                "vehicle": vehicle,
                # Rounded up: paths faster than the cruise speed are refused.
                "cruise_speed_mps": math.ceil(1e4 * max(speed, 0.05)) / 1e4,
            }
        ],
    }
    if kind == "tour":
        tables["task"] = {
            "type": "tour",
            "positions_m": [[round(x, 6) for x in stop.position_m] for stop in route],
            "shared": False,
            "ordered": True,
            "tolerance_m": limits.radius_m,
        }
    return tables


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
