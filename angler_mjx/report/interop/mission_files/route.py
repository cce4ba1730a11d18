"""Meaning of mission items: positions to go to, speeds, holds and headings, as ArduSub takes them.

Depth is negative altitude: ArduSub's home is at the surface. An altitude of 0 keeps the depth, and
a latitude and longitude of 0 keep the position. Commands between two way-points act when the first
one is reached.
"""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from angler_mjx.errors import ConfigError
from angler_mjx.files import format_path
from angler_mjx.frames import GeodeticOrigin, geodetic_to_local
from angler_mjx.report.interop.mission_files import items as mav
from angler_mjx.report.interop.mission_files.items import Mission, MissionItem, check_position
from angler_mjx.robot.importing.notes import NoteKind, Notes

type Position = tuple[float, float, float]

MAX_STOPS = 1024
"""Max number of positions of a mission, jumps and circles unrolled."""
MAX_DISTANCE_M = 5_000.0
"""Max distance of a position from W's origin, where a tangent plane is true to 1e-6."""
_MIN_SPEED_MPS = 0.01
_MAX_CIRCLE_TURNS, _MIN_RADIUS_M = 40, 0.1
_GROUND_SPEEDS = (0, 1)
"""Types of DO_CHANGE_SPEED that set the horizontal speed; 2 and 3 are of climbing and diving."""


@dataclass(frozen=True, kw_only=True)
class VehicleLimits:
    """Settings of an ArduSub that a mission depends on; the defaults are those of 4.6."""

    speed_mps: float = 1.0
    """WPNAV_SPEED, horizontal."""
    speed_up_mps: float = 2.5
    """WPNAV_SPEED_UP."""
    speed_down_mps: float = 1.5
    """WPNAV_SPEED_DN."""
    acceleration_mps2: float = 2.5
    """WPNAV_ACCEL, horizontal."""
    acceleration_z_mps2: float = 1.0
    """WPNAV_ACCEL_Z."""
    jerk_mps3: float = 1.0
    """WPNAV_JERK."""
    radius_m: float = 2.0
    """WPNAV_RADIUS: distance at which a way-point counts as reached."""
    circle_radius_m: float = 10.0
    """CIRCLE_RADIUS."""
    circle_rate_radps: float = math.radians(2.0)
    """CIRCLE_RATE."""
    max_speed_mps: float = math.inf
    """Max speed of the vehicle in any direction; faster missions are flown with it."""


@dataclass(frozen=True, kw_only=True)
class Circle:
    """Circle about a vertical axis, at one depth."""

    center_m: Position
    radius_m: float
    turns: float
    """Number of turns; below 0 counter-clockwise, seen from above."""


@dataclass(frozen=True, kw_only=True)
class Stop:
    """Position at which a vehicle comes to rest, and the motion to it."""

    position_m: Position
    """In W."""
    item: MissionItem
    speed_mps: float
    """Max horizontal speed on the leg to it."""
    hold_s: float = 0.0
    """Time at rest there; infinite for the end of a mission without an end."""
    yaw_rad: float | None = None
    """Heading during the leg and the hold, about z up, 0 = east; None: that of the leg."""
    circle: Circle | None = None
    """Circle that is flown from there, back to there."""


@dataclass
class _State:
    """State of the vehicle between two items."""

    position_m: Position
    speed_mps: float
    yaw_rad: float | None = None
    """Heading that CONDITION_YAW set, for the next leg."""
    stops: list[Stop] = field(default_factory=list)


def build_route(
    mission: Mission,
    origin: GeodeticOrigin,
    limits: VehicleLimits,
    notes: Notes,
    *,
    start_m: Position,
    top_m: float,
) -> tuple[Stop, ...]:
    """Return the stops of a mission.

    Args:
        mission: from a file.
        origin: of W.
        limits: of the vehicle.
        notes: receives what is dropped, assumed, snapped or converted.
        start_m: position of the vehicle before the mission.
        top_m: greatest height of the vehicle, below 0; positions above are snapped to it.

    Raises:
        ConfigError: an item has a frame or a value that cannot be flown; names its line or key.
    """
    state = _State(position_m=start_m, speed_mps=min(limits.speed_mps, limits.max_speed_mps))
    builder = _RouteBuilder(mission, origin, limits, notes, top_m)
    for item in unroll_jumps(mission):
        builder.add(item, state)
        if state.stops and math.isinf(state.stops[-1].hold_s):
            later = [other for other in mission.items if other.number > item.number]
            if later:
                notes.add(
                    "dropped",
                    f"{len(later)} items after {item.name}, which has no end",
                    *(other.location for other in later),
                )
            break
        if len(state.stops) > MAX_STOPS:
            raise item.location.fault(
                f": more than {MAX_STOPS} positions with its jumps; shorten the mission"
            )
    if not state.stops:
        raise ConfigError(
            f"{format_path(mission.file)}: no item with a position that can be flown; add "
            "way-points (NAV_WAYPOINT)"
        )
    return tuple(state.stops)


class _RouteBuilder:
    """Adds the meaning of one item after the other."""

    def __init__(
        self,
        mission: Mission,
        origin: GeodeticOrigin,
        limits: VehicleLimits,
        notes: Notes,
        top_m: float,
    ) -> None:
        self._mission, self._origin, self._limits = mission, origin, limits
        self._notes, self._top_m = notes, top_m

    def add(self, item: MissionItem, state: _State) -> None:
        """Add one item."""
        match item.command:
            case mav.WAYPOINT | mav.SPLINE_WAYPOINT:
                if item.command == mav.SPLINE_WAYPOINT:
                    self._note("converted", item, "a line to a stop instead of a spline")
                self._go(item, state, self._position(item, state), hold_s=self._hold(item))
            case mav.LOITER_UNLIMITED:
                self._go(item, state, self._position(item, state), hold_s=math.inf)
            case mav.LOITER_TIME:
                self._go(item, state, self._position(item, state), hold_s=self._hold(item))
            case mav.LOITER_TURNS:
                self._circle(item, state)
            case mav.DELAY:
                self._delay(item, state)
            case mav.RETURN_TO_LAUNCH:
                home = self._mission.home or self._origin
                x, y = geodetic_to_local(self._origin, home.latitude_deg, home.longitude_deg)
                self._note("snapped", item, f"home at the surface to a depth of {-self._top_m:g} m")
                self._go(item, state, (x, y, self._top_m))
            case mav.LAND:
                if item.has_position:
                    x, y = self._level_position(item, state)
                    self._go(item, state, (x, y, state.position_m[2]))
                self._note("snapped", item, f"the surface to a depth of {-self._top_m:g} m")
                self._go(item, state, (*state.position_m[:2], self._top_m))
            case mav.CHANGE_SPEED:
                self._change_speed(item, state)
            case mav.CONDITION_YAW:
                self._turn(item, state)
            case _:
                self._note("dropped", item, "not flown here")

    def _note(self, kind: NoteKind, item: MissionItem, text: str) -> None:
        self._notes.add(kind, f"{item.name}: {text}", item.location)

    def _go(
        self, item: MissionItem, state: _State, position: Position, *, hold_s: float = 0.0
    ) -> None:
        state.stops.append(
            Stop(
                position_m=position,
                item=item,
                speed_mps=state.speed_mps,
                hold_s=hold_s,
                yaw_rad=state.yaw_rad,
            )
        )
        state.position_m, state.yaw_rad = position, None

    def _hold(self, item: MissionItem) -> float:
        hold_s = item.parameter(1)
        if not 0.0 <= hold_s < math.inf:
            raise item.location.fault(f": {item.name} holds for {hold_s:g} s; give 0 or more")
        return hold_s

    def _delay(self, item: MissionItem, state: _State) -> None:
        if item.parameter(1) <= 0:
            self._note("dropped", item, "a time of the day, which the simulator has not")
        elif state.stops and state.stops[-1].circle is None:
            last = state.stops[-1]
            state.stops[-1] = replace(last, hold_s=last.hold_s + self._hold(item))
        else:
            self._go(item, state, state.position_m, hold_s=self._hold(item))

    def _circle(self, item: MissionItem, state: _State) -> None:
        turns, signed_radius = item.parameter(1), item.parameter(3)
        if not 1 <= turns <= _MAX_CIRCLE_TURNS:
            raise item.location.fault(
                f": {item.name} with {turns:g} turns; give 1 to {_MAX_CIRCLE_TURNS}"
            )
        radius = abs(signed_radius) or self._limits.circle_radius_m
        if radius < _MIN_RADIUS_M:
            raise item.location.fault(
                f": {item.name} with a radius of {radius:g} m; give {_MIN_RADIUS_M:g} m or more"
            )
        if not signed_radius:
            self._note("assumed", item, f"radius {radius:g} m (CIRCLE_RADIUS)")
        center = self._position(item, state)
        offset = np.subtract(state.position_m[:2], center[:2])
        distance = float(np.hypot(*offset))
        # From its middle, ArduSub leaves a circle behind itself; south is as good.
        direction = offset / distance if distance > 1e-3 else np.array([0.0, -1.0])
        edge = center[:2] + radius * direction
        self._go(item, state, (float(edge[0]), float(edge[1]), center[2]))
        clockwise = signed_radius >= 0
        circle = Circle(center_m=center, radius_m=radius, turns=turns if clockwise else -turns)
        state.stops[-1] = replace(state.stops[-1], circle=circle)

    def _change_speed(self, item: MissionItem, state: _State) -> None:
        kind, speed = item.parameter(1), item.parameter(2)
        if kind not in _GROUND_SPEEDS:
            self._note("dropped", item, f"type {kind:g}: of climbing or diving")
            return
        if speed <= 0:
            self._note("dropped", item, f"{speed:g} m/s: no change")
            return
        if speed < _MIN_SPEED_MPS:
            raise item.location.fault(
                f": {item.name} to {speed:g} m/s; give {_MIN_SPEED_MPS:g} m/s or more"
            )
        if item.parameter(3) > 0:
            self._note("dropped", item, f"throttle {item.parameter(3):g} %")
        limit = self._limits.max_speed_mps
        if not speed <= limit:
            self._note("snapped", item, f"{speed:g} m/s to the vehicle's {limit:.3g} m/s")
        state.speed_mps = min(speed, limit)

    def _turn(self, item: MissionItem, state: _State) -> None:
        angle, is_relative = math.radians(item.parameter(1)), item.parameter(4) == 1
        if is_relative:
            self._note("dropped", item, "a relative angle; give an absolute one")
            return
        state.yaw_rad = math.remainder(0.5 * math.pi - angle, math.tau)

    def _level_position(self, item: MissionItem, state: _State) -> tuple[float, float]:
        check_position(item)
        if not item.has_position:
            return state.position_m[:2]
        x, y = geodetic_to_local(self._origin, item.latitude_deg or 0.0, item.longitude_deg or 0.0)
        if (distance := math.hypot(x, y)) > MAX_DISTANCE_M:
            raise item.location.fault(
                f": {item.name} is {distance / 1e3:.1f} km from the origin of the world; "
                f"{MAX_DISTANCE_M / 1e3:g} km are the most: set home in the plan, or give --origin"
            )
        return x, y

    def _position(self, item: MissionItem, state: _State) -> Position:
        x, y = self._level_position(item, state)
        if item.frame not in (*mav.RELATIVE_FRAMES, *mav.SEA_LEVEL_FRAMES):
            name = mav.FRAME_NAMES.get(item.frame, "no frame of MAVLink")
            terrain = "; the height of the terrain is not in the file" if "TERRAIN" in name else ""
            raise item.location.fault(
                f": frame {item.frame} ({name}) of {item.name}{terrain}; plan with altitudes "
                f"relative to home (frame {mav.RELATIVE_FRAME})"
            )
        altitude = item.altitude_m
        if not altitude:
            self._note("converted", item, "altitude 0 keeps the depth, as in ArduSub")
            return x, y, state.position_m[2]
        if item.frame in mav.SEA_LEVEL_FRAMES:
            self._note(
                "converted",
                item,
                f"altitude above sea level, with the surface at {self._origin.altitude_m:g} m; "
                "ArduSub flies altitudes relative to home alone",
            )
            altitude -= self._origin.altitude_m
        if altitude > 0:
            raise item.location.fault(
                f": altitude {item.altitude_m:g} m of {item.name} is {altitude:g} m above the "
                "surface; give depths as negative altitudes"
            )
        if altitude > self._top_m:
            self._note(
                "snapped", item, f"a depth of {-altitude:g} m to {-self._top_m:g} m, all in water"
            )
        return x, y, min(altitude, self._top_m)


def unroll_jumps(mission: Mission) -> list[MissionItem]:
    """Return the items in the order in which they act, jumps repeated as often as they say.

    Raises:
        ConfigError: a jump has no end, or leads nowhere.
    """
    order: list[MissionItem] = []
    left: dict[int, int] = {}
    index = 0
    while index < len(mission.items):
        item = mission.items[index]
        index += 1
        if item.command != mav.JUMP:
            order.append(item)
            if len(order) > MAX_STOPS:
                raise item.location.fault(
                    f": more than {MAX_STOPS} items with its jumps; shorten the mission"
                )
            continue
        target, count = item.parameter(1), item.parameter(2)
        if not (1 <= target <= len(mission.items) and target == int(target)):
            raise item.location.fault(
                f": DO_JUMP to item {target:g}; there are 1 to {len(mission.items)}"
            )
        if count < 0 or count != int(count):
            raise item.location.fault(
                f": DO_JUMP {count:g} times; give a number of times, for the plan has to end"
            )
        remaining = left.setdefault(item.number, int(count))
        if remaining > 0:
            left[item.number] = remaining - 1
            index = int(target) - 1
    return order
