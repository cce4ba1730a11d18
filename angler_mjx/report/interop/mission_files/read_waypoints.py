"""Way-point files in the format "QGC WPL 110" of Mission Planner, MAVProxy and QGroundControl.

Each line holds twelve columns, separated by tabs or space: number, current, frame, command, four
parameters, latitude, longitude, altitude, autocontinue. Line 0 is home. Lines that begin with ``#``
are comments.
"""

import math
from pathlib import Path

from angler_mjx.errors import ConfigError, format_value
from angler_mjx.files import format_path, read_text
from angler_mjx.frames import GeodeticOrigin
from angler_mjx.report.interop.mission_files.items import (
    ItemLocation,
    Mission,
    MissionItem,
    check_position,
)

MAX_BYTES = 1 << 24
HEADER = "QGC WPL 110"
_HEADERS = ("QGC WPL 100", HEADER)
_COLUMNS = (
    "number",
    "current",
    "frame",
    "command",
    "param1",
    "param2",
    "param3",
    "param4",
    "latitude",
    "longitude",
    "altitude",
    "autocontinue",
)
_MAX_NUMBER = 1e12
"""Numbers of items are degrees, metres, seconds and flags."""
_WHOLE = ("number", "current", "frame", "command", "autocontinue")


def read_waypoints(path: Path) -> Mission:
    """Read a way-point file.

    Raises:
        ConfigError: the file is none, or has a fault; names line, column and value.
    """
    lines = read_text(path, MAX_BYTES).splitlines()
    if not lines or " ".join(lines[0].split()) not in _HEADERS:
        first = format_value(lines[0] if lines else "")
        raise ConfigError(
            f"{format_path(path)}:1: {first}: must be {HEADER}; save the mission as way-points in "
            "Mission Planner or MAVProxy, or as .plan in QGroundControl"
        )
    items: list[MissionItem] = []
    for line_number, line in enumerate(lines[1:], 2):
        columns = line.partition("#")[0].split()
        if not columns:
            continue
        location = ItemLocation(file=path, part=f":{line_number}")
        item = _read_line(columns, location)
        if item.number != len(items):
            raise location.fault(
                f": number = {item.number}: must be {len(items)}; lines are numbered from 0, which "
                "is home"
            )
        items.append(item)
    if not items:
        raise ConfigError(f"{format_path(path)}: no lines below the first; save a mission first")
    first_item = items[0]
    home = None
    if first_item.has_position:
        home = GeodeticOrigin(
            latitude_deg=first_item.latitude_deg or 0.0,
            longitude_deg=first_item.longitude_deg or 0.0,
            altitude_m=first_item.altitude_m or 0.0,
        )
        check_position(first_item)
    return Mission(file=path, home=home, items=tuple(items[1:]))


def _read_line(columns: list[str], location: ItemLocation) -> MissionItem:
    if len(columns) != len(_COLUMNS):
        raise location.fault(
            f": {len(columns)} columns; must be {len(_COLUMNS)}: {', '.join(_COLUMNS)}"
        )
    numbers: dict[str, float | None] = {}
    for name, text in zip(_COLUMNS, columns, strict=True):
        try:
            number = float(text)
        except ValueError:
            raise location.fault(f": {name} = {format_value(text)}: must be a number") from None
        if name in _WHOLE and not (math.isfinite(number) and number == int(number)):
            raise location.fault(f": {name} = {text}: must be a whole number")
        if abs(number) > _MAX_NUMBER:
            raise location.fault(f": {name} = {text}: must be a finite number")
        numbers[name] = None if math.isnan(number) else number
    return MissionItem(
        number=int(numbers["number"] or 0),
        command=int(numbers["command"] or 0),
        frame=int(numbers["frame"] or 0),
        parameters=(numbers["param1"], numbers["param2"], numbers["param3"], numbers["param4"]),
        latitude_deg=numbers["latitude"],
        longitude_deg=numbers["longitude"],
        altitude_m=numbers["altitude"],
        location=location,
    )
