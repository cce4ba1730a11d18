"""Parameters that an ArduSub is started with: what differs from its defaults, and why.

A file of ``--defaults`` that names a parameter which the firmware does not know says nothing about
it. So the values are read back from the running autopilot and compared (`differences`).
"""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Literal, get_args

from angler_mjx.errors import ConfigError, shown
from angler_mjx.files import named, read_text
from angler_mjx.robot.vehicles.config import VehicleConfig
from angler_sitl.firmware import airframe

type Level = Literal["thrusters", "guided", "poshold", "althold", "manual"]
"""What is commanded: thrusters themselves, or one of the firmware's own modes."""
type Source = Literal["vision", "vicon", "gps"]
"""Where its filter learns its position: from us, from SITL's own Vicon, or from SITL's own GPS."""

LEVELS: tuple[Level, ...] = get_args(Level.__value__)
SOURCES: tuple[Source, ...] = get_args(Source.__value__)

PASSTHROUGH = 50
"""SERVOn_FUNCTION of RC channel k passed through is 50 + k; 1 would do the same for k = n only."""

RENAMED = {"GPS1_TYPE": "GPS_TYPE", "SYSID_THISMAV": "MAV_SYSID"}
"""Names of 4.6 and what other versions call them. Both are written; one has to be known."""

LONGEST_NAME = 16
"""Letters of a parameter's name, of MAVLink."""
_MOST_BYTES = 1 << 20
_QGROUNDCONTROL_FIELDS, _AUTOPILOT = 5, "1"
"""Fields of a line of QGroundControl, and MAV_COMP_ID_AUTOPILOT1 in its second one."""

_STREAMS = ("RAW_SENS", "EXT_STAT", "RC_CHAN", "POSITION", "EXTRA1", "EXTRA2", "EXTRA3")

_COMMON: dict[str, tuple[float, str]] = {
    "SIM_RATE_HZ": (400, "how often physics is stepped"),
    "FS_GCS_ENABLE": (0, "would disarm after 5 s of its own clock without a heartbeat"),
    "BATT_MONITOR": (4, "a battery to report; SITL simulates its voltage"),
    "LOG_DISARMED": (0, "the boot need not be in the log"),
}
_EXTERNAL: dict[str, tuple[float, str]] = {
    "VISO_TYPE": (1, "positions come by MAVLink"),
    "VISO_DELAY_MS": (0, "ours are sent 30 ms old: what the firmware takes off for transport"),
    "GPS1_TYPE": (0, "no GPS under water"),
    "EK3_SRC1_POSXY": (6, "position from external navigation"),
    "EK3_SRC1_VELXY": (6, "velocity from external navigation"),
    "EK3_SRC1_POSZ": (6, "depth from it too: the barometer's zero moves at the surface"),
    "EK3_SRC1_VELZ": (6, "and vertical velocity"),
    "EK3_SRC1_YAW": (6, "and heading: no compass to align in flight"),
}
_SOURCE: dict[str, dict[str, tuple[float, str]]] = {
    "vision": _EXTERNAL,
    "vicon": {
        **_EXTERNAL,
        "SERIAL5_PROTOCOL": (2, "MAVLink from SITL's own Vicon"),
        "SIM_VICON_TMASK": (3, "it sends position and velocity"),
    },
    # Of these two the EKF's defaults are the barometer and nothing.
    "gps": {
        "EK3_SRC1_POSZ": (3, "depth from the GPS, which works under water here"),
        "EK3_SRC1_VELZ": (3, "and vertical velocity"),
    },
}
_STICKS = {"JS_GAIN_DEFAULT": (1.0, "full stick is full thrust")}


def for_vehicle(
    vehicle: VehicleConfig, level: Level, source: Source, *, log: bool = True
) -> dict[str, float]:
    """Parameters of one robot.

    Args:
        vehicle: Its vehicle file.
        level: What it is commanded by.
        source: Where it learns its position.
        log: Whether it writes its own log, some 45 kB for each second it is armed.

    Raises:
        ConfigError: the vehicle has no matching ArduSub frame, or no such level or source.
    """
    _known("level", level, LEVELS)
    _known("source", source, SOURCES)
    given = {"FRAME_CONFIG": float(airframe.CONFIG[airframe.frame_of(vehicle)])}
    for table in (_COMMON, _SOURCE[source], {} if level == "thrusters" else _STICKS):
        given |= {name: float(value) for name, (value, _) in table.items()}
    given |= {f"SR{line}_{stream}": 0.0 for line in (0, 1) for stream in _STREAMS}
    given["LOG_BACKEND_TYPE"] = 1.0 if log else 0.0
    if level == "thrusters":
        count = len(vehicle.thrusters.layout)
        given |= {f"SERVO{n}_FUNCTION": float(PASSTHROUGH + n) for n in range(1, count + 1)}
    return given


def write(path: Path, parameters: Mapping[str, float]) -> None:
    """Write a parameter file: reason, name and value of each, sorted by name."""
    path.write_text("".join(_lines(parameters)), encoding="utf-8")


def read(path: Path) -> dict[str, float]:
    """Read a parameter file of MAVProxy, Mission Planner, QGroundControl or `angler tune`.

    MAVProxy and Mission Planner write a name and its value on a line, separated by a comma or by
    space (``.param``, ``.parm``); QGroundControl writes system, component, name, value and
    MAV_PARAM_TYPE, separated by tabs (``.params``). Comments begin with ``#``.

    Returns:
        Values by name, in the firmware's units.

    Raises:
        ConfigError: there is no such file, a line is none of these, or lines are of two vehicles.
    """
    found = {}
    system = None
    for number, line in enumerate(read_text(path, _MOST_BYTES).splitlines(), 1):
        words = line.partition("#")[0].replace(",", " ").split()
        if not words:
            continue
        where = f"{named(path)}:{number}: {shown(line.strip())}"
        if len(words) == _QGROUNDCONTROL_FIELDS:
            if words[1] != _AUTOPILOT:
                raise ConfigError(
                    f"{where}: component {shown(words[1])} is not the autopilot ({_AUTOPILOT}); "
                    "remove its lines"
                )
            if system not in (None, words[0]):
                raise ConfigError(
                    f"{where}: system {shown(words[0])} after system {shown(system)}; "
                    "keep the lines of one vehicle"
                )
            system, words = words[0], words[2:4]
        try:
            name, value = words[0], float(words[1])
            usable = len(words) == 2 and math.isfinite(value) and len(name) <= LONGEST_NAME
        except (IndexError, ValueError):
            usable = False
        if not usable or name[0].isdigit():
            raise ConfigError(
                f"{where}: write NAME,VALUE, or SYSTEM COMPONENT NAME VALUE TYPE as QGroundControl"
            )
        found[name] = value
    return found


def differences(ours: Mapping[str, float], read: Mapping[str, float]) -> list[str]:
    """What an autopilot has otherwise than it was told, a sentence each, sorted; empty if nothing.

    Args:
        ours: Values it was started with.
        read: All of its parameters, read back.
    """
    found = []
    for name, value in sorted(ours.items()):
        names = [one for one in (name, RENAMED.get(name)) if one is not None and one in read]
        if not names:
            found.append(f"{name} = {value:g}: unknown to this firmware")
        # The firmware keeps float32, and whole numbers exactly.
        elif abs(read[names[0]] - value) > 1e-6 * max(1.0, abs(value)):
            found.append(f"{names[0]} = {value:g}: the autopilot has {read[names[0]]:g}")
    return found


def reason(name: str) -> str:
    """Why a parameter of `for_vehicle` is set, in a few words; "" for others."""
    for table in (_COMMON, _STICKS, *_SOURCE.values()):
        if name in table:
            return table[name][1]
    if name.startswith("SR"):
        return "streams are asked for one by one"
    if name.startswith("SERVO"):
        return "RC channels go to the thrusters as they are"
    return {
        "FRAME_CONFIG": "the frame whose motors are the vehicle's thrusters",
        "LOG_BACKEND_TYPE": "1: its own log in its folder; 0: none",
    }.get(name, "")


def _lines(parameters: Mapping[str, float]) -> list[str]:
    lines = []
    for name, value in sorted(parameters.items()):
        why = reason(name)
        for one in (name, RENAMED.get(name)):
            if one is not None:
                lines.append(f"{one} {value:.9g}{f'  # {why}' if why else ''}\n")
    return lines


def _known(key: str, value: str, known: tuple[str, ...]) -> None:
    if value not in known:
        raise ConfigError(f"--{key} {value}: choose one of {', '.join(known)}")
