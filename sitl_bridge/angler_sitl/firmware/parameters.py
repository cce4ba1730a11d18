"""Start parameters of an ArduSub: its differences from the defaults, and their reasons.

The firmware silently ignores unknown parameters in a ``--defaults`` file. So the values are read
back from the running autopilot and compared (`find_differences`).
"""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Literal, get_args

from angler_mjx.errors import ConfigError, format_value
from angler_mjx.files import format_path, read_text
from angler_mjx.robot.vehicles.config import VehicleConfig
from angler_sitl.firmware import airframe

type CommandLevel = Literal["thrusters", "guided", "poshold", "althold", "manual"]
"""Entry level of commands: the thrusters themselves, or one of the firmware's own modes."""
type PositionSource = Literal["vision", "vicon", "gps"]
"""Position source of the filter: external navigation, SITL's own Vicon, or SITL's own GPS."""

type ParameterFormat = Literal["param", "params"]
"""File format of parameters: of Mission Planner and MAVProxy, or of QGroundControl."""

LEVELS: tuple[CommandLevel, ...] = get_args(CommandLevel.__value__)
SOURCES: tuple[PositionSource, ...] = get_args(PositionSource.__value__)

PASSTHROUGH = 50
"""SERVOn_FUNCTION of RC channel k passed through is 50 + k; 1 would do the same for k = n only."""

RENAMED = {"GPS1_TYPE": "GPS_TYPE", "SYSID_THISMAV": "MAV_SYSID"}
"""Parameter names of 4.6 and of other versions. Both are written; at least one must be known."""

MAX_NAME_LENGTH = 16
"""Max letters of a parameter's name in MAVLink."""
_MAX_BYTES = 1 << 20
_QGROUNDCONTROL_FIELDS, _AUTOPILOT = 5, "1"
"""Fields of a QGroundControl line, and MAV_COMP_ID_AUTOPILOT1 in its second field."""
_REAL32 = 9
"""MAV_PARAM_TYPE of float32; below it are whole numbers."""

_STREAMS = ("RAW_SENS", "EXT_STAT", "RC_CHAN", "POSITION", "EXTRA1", "EXTRA2", "EXTRA3")

_COMMON_PARAMETERS: dict[str, tuple[float, str]] = {
    "SIM_RATE_HZ": (400, "how often physics is stepped"),
    "FS_GCS_ENABLE": (0, "would disarm after 5 s of its own clock without a heartbeat"),
    "BATT_MONITOR": (4, "a battery to report; SITL simulates its voltage"),
    "LOG_DISARMED": (0, "the boot need not be in the log"),
}
_EXTERNAL_PARAMETERS: dict[str, tuple[float, str]] = {
    "VISO_TYPE": (1, "positions come by MAVLink"),
    "VISO_DELAY_MS": (0, "ours are sent 30 ms old: what the firmware takes off for transport"),
    "GPS1_TYPE": (0, "no GPS under water"),
    "EK3_SRC1_POSXY": (6, "position from external navigation"),
    "EK3_SRC1_VELXY": (6, "velocity from external navigation"),
    "EK3_SRC1_POSZ": (6, "depth from it too: the barometer's zero moves at the surface"),
    "EK3_SRC1_VELZ": (6, "and vertical velocity"),
    "EK3_SRC1_YAW": (6, "and heading: no compass to align in flight"),
}
_SOURCE_PARAMETERS: dict[str, dict[str, tuple[float, str]]] = {
    "vision": _EXTERNAL_PARAMETERS,
    "vicon": {
        **_EXTERNAL_PARAMETERS,
        "SERIAL5_PROTOCOL": (2, "MAVLink from SITL's own Vicon"),
        "SIM_VICON_TMASK": (3, "it sends position and velocity"),
    },
    # The EKF's defaults of these two parameters are the barometer and none.
    "gps": {
        "EK3_SRC1_POSZ": (3, "depth from the GPS, which works under water here"),
        "EK3_SRC1_VELZ": (3, "and vertical velocity"),
    },
}
_STICK_PARAMETERS = {"JS_GAIN_DEFAULT": (1.0, "full stick is full thrust")}


def for_vehicle(
    vehicle: VehicleConfig, level: CommandLevel, source: PositionSource, *, log: bool = True
) -> dict[str, float]:
    """Return the parameters of one robot.

    Args:
        vehicle: Its vehicle file.
        level: Where commands enter.
        source: Its position source.
        log: Whether it writes its own log, some 45 kB for each second it is armed.

    Raises:
        ConfigError: the vehicle has no matching ArduSub frame, or no such level or source.
    """
    _check_choice("level", level, LEVELS)
    _check_choice("source", source, SOURCES)
    parameters = {"FRAME_CONFIG": float(airframe.FRAME_CONFIGS[airframe.find_frame(vehicle)])}
    for table in (
        _COMMON_PARAMETERS,
        _SOURCE_PARAMETERS[source],
        {} if level == "thrusters" else _STICK_PARAMETERS,
    ):
        parameters |= {name: float(value) for name, (value, _) in table.items()}
    parameters |= {f"SR{line}_{stream}": 0.0 for line in (0, 1) for stream in _STREAMS}
    parameters["LOG_BACKEND_TYPE"] = 1.0 if log else 0.0
    if level == "thrusters":
        count = len(vehicle.thrusters.layout)
        parameters |= {f"SERVO{n}_FUNCTION": float(PASSTHROUGH + n) for n in range(1, count + 1)}
    return parameters


def write_parameters(path: Path, parameters: Mapping[str, float]) -> None:
    """Write a parameter file: reason, name and value of each, sorted by name."""
    path.write_text("".join(_format_lines(parameters)), encoding="utf-8")


def read_parameters(path: Path) -> dict[str, float]:
    """Read a parameter file of MAVProxy, Mission Planner, QGroundControl or `angler tune`.

    MAVProxy and Mission Planner write a name and its value on a line, separated by a comma or by
    space (``.param``, ``.parm``); QGroundControl writes system, component, name, value and
    MAV_PARAM_TYPE, separated by tabs (``.params``). Comments begin with ``#``.

    Returns:
        Values by name, in the firmware's units.

    Raises:
        ConfigError: no such file, a line of another format, or lines of two vehicles.
    """
    values = {}
    system = None
    for number, line in enumerate(read_text(path, _MAX_BYTES).splitlines(), 1):
        columns = line.partition("#")[0].replace(",", " ").split()
        if not columns:
            continue
        location = f"{format_path(path)}:{number}: {format_value(line.strip())}"
        if len(columns) == _QGROUNDCONTROL_FIELDS:
            if columns[1] != _AUTOPILOT:
                raise ConfigError(
                    f"{location}: component {format_value(columns[1])} is not the autopilot "
                    f"({_AUTOPILOT}); "
                    "remove its lines"
                )
            if system not in (None, columns[0]):
                raise ConfigError(
                    f"{location}: system {format_value(columns[0])} after system "
                    f"{format_value(system)}; "
                    "keep the lines of one vehicle"
                )
            system, columns = columns[0], columns[2:4]
        try:
            name, value = columns[0], float(columns[1])
            usable = len(columns) == 2 and math.isfinite(value) and len(name) <= MAX_NAME_LENGTH
        except (IndexError, ValueError):
            usable = False
        if not usable or name[0].isdigit():
            raise ConfigError(
                f"{location}: write NAME,VALUE, or SYSTEM COMPONENT NAME VALUE TYPE as "
                "QGroundControl"
            )
        values[name] = value
    return values


def format_parameters(
    parameters: Mapping[str, float],
    format_: ParameterFormat,
    *,
    types: Mapping[str, int] | None = None,
    sysid: int = 1,
    version: str = "",
) -> str:
    """Return the text of a parameter file that a ground station loads, sorted by name.

    Args:
        parameters: Values by name.
        format_: ``param`` of Mission Planner and MAVProxy, or ``params`` of QGroundControl.
        types: MAV_PARAM_TYPE of each parameter, for ``params``; REAL32 where left out.
        sysid: MAVLink system number of the vehicle, for ``params``.
        version: Of the firmware, for ``params``.
    """
    if format_ == "param":
        return "".join(f"{name},{value:.9g}\n" for name, value in sorted(parameters.items()))
    lines = [
        f"# Onboard parameters for Vehicle {sysid}",
        "#",
        "# Stack: ArduPilot",
        "# Vehicle: Sub",
        f"# Version: {version}".rstrip(),
        "#",
        "# Vehicle-Id Component-Id Name Value Type",
    ]
    for name, value in sorted(parameters.items()):
        kind = (types or {}).get(name, _REAL32)
        number = f"{value:.18f}" if kind >= _REAL32 else f"{value:.0f}"
        lines.append("\t".join([str(sysid), _AUTOPILOT, name, number, str(kind)]))
    return "\n".join(lines) + "\n"


def find_differences(expected: Mapping[str, float], actual: Mapping[str, float]) -> list[str]:
    """Return the parameters that differ from their start values, a sentence each, sorted.

    Args:
        expected: Start values.
        actual: All of its parameters, read back.
    """
    messages = []
    for name, value in sorted(expected.items()):
        names = [
            candidate
            for candidate in (name, RENAMED.get(name))
            if candidate is not None and candidate in actual
        ]
        if not names:
            messages.append(f"{name} = {value:g}: unknown to this firmware")
        # The firmware keeps float32, and whole numbers exactly.
        elif abs(actual[names[0]] - value) > 1e-6 * max(1.0, abs(value)):
            messages.append(f"{names[0]} = {value:g}: the autopilot has {actual[names[0]]:g}")
    return messages


def explain_parameter(name: str) -> str:
    """Return the reason for a parameter of `for_vehicle`, in a few words; "" for others."""
    for table in (_COMMON_PARAMETERS, _STICK_PARAMETERS, *_SOURCE_PARAMETERS.values()):
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


def _format_lines(parameters: Mapping[str, float]) -> list[str]:
    lines = []
    for name, value in sorted(parameters.items()):
        comment = explain_parameter(name)
        for key in (name, RENAMED.get(name)):
            if key is not None:
                lines.append(f"{key} {value:.9g}{f'  # {comment}' if comment else ''}\n")
    return lines


def _check_choice(key: str, value: str, choices: tuple[str, ...]) -> None:
    if value not in choices:
        raise ConfigError(f"--{key} {value}: choose one of {', '.join(choices)}")
