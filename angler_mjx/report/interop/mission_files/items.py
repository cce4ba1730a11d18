"""Missions as lists of MAVLink items, whatever file they came from."""

import math
from dataclasses import dataclass
from pathlib import Path

from angler_mjx.errors import ConfigError
from angler_mjx.files import format_path
from angler_mjx.frames import GeodeticOrigin

WAYPOINT, LOITER_UNLIMITED, LOITER_TURNS, LOITER_TIME = 16, 17, 18, 19
RETURN_TO_LAUNCH, LAND, SPLINE_WAYPOINT, DELAY = 20, 21, 82, 93
CONDITION_YAW, JUMP, CHANGE_SPEED = 115, 177, 178

RELATIVE_FRAME, MISSION_FRAME = 3, 2
"""MAV_FRAME of altitudes relative to home, and of items without a position."""
SEA_LEVEL_FRAMES, RELATIVE_FRAMES = (0, 5), (3, 6)
"""MAV_FRAMEs of altitudes above sea level and above home, with degrees and with integers."""

FRAME_NAMES = {
    0: "MAV_FRAME_GLOBAL",
    1: "MAV_FRAME_LOCAL_NED",
    2: "MAV_FRAME_MISSION",
    3: "MAV_FRAME_GLOBAL_RELATIVE_ALT",
    4: "MAV_FRAME_LOCAL_ENU",
    5: "MAV_FRAME_GLOBAL_INT",
    6: "MAV_FRAME_GLOBAL_RELATIVE_ALT_INT",
    7: "MAV_FRAME_LOCAL_OFFSET_NED",
    8: "MAV_FRAME_BODY_NED",
    9: "MAV_FRAME_BODY_OFFSET_NED",
    10: "MAV_FRAME_GLOBAL_TERRAIN_ALT",
    11: "MAV_FRAME_GLOBAL_TERRAIN_ALT_INT",
    12: "MAV_FRAME_BODY_FRD",
    20: "MAV_FRAME_LOCAL_FRD",
    21: "MAV_FRAME_LOCAL_FLU",
}

COMMAND_NAMES = {
    16: "NAV_WAYPOINT",
    17: "NAV_LOITER_UNLIM",
    18: "NAV_LOITER_TURNS",
    19: "NAV_LOITER_TIME",
    20: "NAV_RETURN_TO_LAUNCH",
    21: "NAV_LAND",
    22: "NAV_TAKEOFF",
    31: "NAV_LOITER_TO_ALT",
    80: "NAV_ROI",
    82: "NAV_SPLINE_WAYPOINT",
    84: "NAV_VTOL_TAKEOFF",
    85: "NAV_VTOL_LAND",
    92: "NAV_GUIDED_ENABLE",
    93: "NAV_DELAY",
    94: "NAV_PAYLOAD_PLACE",
    112: "CONDITION_DELAY",
    113: "CONDITION_CHANGE_ALT",
    114: "CONDITION_DISTANCE",
    115: "CONDITION_YAW",
    176: "DO_SET_MODE",
    177: "DO_JUMP",
    178: "DO_CHANGE_SPEED",
    179: "DO_SET_HOME",
    181: "DO_SET_RELAY",
    182: "DO_REPEAT_RELAY",
    183: "DO_SET_SERVO",
    184: "DO_REPEAT_SERVO",
    189: "DO_LAND_START",
    195: "DO_SET_ROI_LOCATION",
    197: "DO_SET_ROI_NONE",
    200: "DO_CONTROL_VIDEO",
    201: "DO_SET_ROI",
    202: "DO_DIGICAM_CONFIGURE",
    203: "DO_DIGICAM_CONTROL",
    205: "DO_MOUNT_CONTROL",
    206: "DO_SET_CAM_TRIGG_DIST",
    207: "DO_FENCE_ENABLE",
    211: "DO_GRIPPER",
    222: "DO_GUIDED_LIMITS",
    530: "SET_CAMERA_MODE",
    600: "JUMP_TAG",
    601: "DO_JUMP_TAG",
    1000: "DO_GIMBAL_MANAGER_PITCHYAW",
    2000: "IMAGE_START_CAPTURE",
    2001: "IMAGE_STOP_CAPTURE",
    2500: "VIDEO_START_CAPTURE",
    2501: "VIDEO_STOP_CAPTURE",
}
"""Names of MAV_CMDs that ground stations write; others are named by their number."""

MAX_LATITUDE_DEG, MAX_LONGITUDE_DEG = 90.0, 180.0


@dataclass(frozen=True, kw_only=True)
class ItemLocation:
    """Part of a mission file: a line of a text, or a key of a JSON file."""

    file: Path
    part: str
    """As in ":4" or ": mission.items[2]"."""

    def __str__(self) -> str:
        """Return the location without folders, for the list of an import."""
        return f"{self.file.name}{self.part}"

    def fault(self, text: str) -> ConfigError:
        """Return the error of a fault, which begins with the file and the part of it."""
        return ConfigError(f"{format_path(self.file)}{self.part}{text}")


@dataclass(frozen=True, kw_only=True)
class MissionItem:
    """One MAVLink mission item; numbers that a file leaves out are None."""

    number: int
    """Sequence number: 0 is home, 1 the first item."""
    command: int
    frame: int
    parameters: tuple[float | None, float | None, float | None, float | None]
    latitude_deg: float | None
    longitude_deg: float | None
    altitude_m: float | None
    location: ItemLocation

    @property
    def name(self) -> str:
        """Name of the command, or its number."""
        return COMMAND_NAMES.get(self.command, f"command {self.command}")

    @property
    def has_position(self) -> bool:
        """Whether latitude and longitude are stated; 0, 0 means the present position."""
        return bool(self.latitude_deg or self.longitude_deg)

    def parameter(self, number: int) -> float:
        """Return a parameter by its number from 1 on; 0 where the file has none."""
        return self.parameters[number - 1] or 0.0


@dataclass(frozen=True, kw_only=True)
class Mission:
    """Mission of one vehicle."""

    file: Path
    home: GeodeticOrigin | None
    """Planned home; None if the file has none."""
    items: tuple[MissionItem, ...]


def check_position(item: MissionItem) -> None:
    """Refuse a position that is not on the globe.

    Raises:
        ConfigError: latitude, longitude or altitude is out of bounds.
    """
    for key, value, limit in (
        ("latitude", item.latitude_deg, MAX_LATITUDE_DEG),
        ("longitude", item.longitude_deg, MAX_LONGITUDE_DEG),
    ):
        if value is not None and not abs(value) <= limit:
            raise item.location.fault(
                f": {key} = {value:g}: must be within -{limit:g} and {limit:g} degrees"
            )
    if item.altitude_m is not None and not math.isfinite(item.altitude_m):
        raise item.location.fault(f": altitude = {item.altitude_m}: must be a finite number")
