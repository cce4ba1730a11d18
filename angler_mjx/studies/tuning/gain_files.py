"""Tuned gains as files: a table for scenarios, and parameters for ArduSub."""

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

from angler_mjx.robot.control.laws.ardusub.gains import ArduSubGains
from angler_mjx.robot.control.stack import Stages

FIRMWARE = ArduSubGains(WPNAV_SPEED=1000.0)
"""The firmware's own defaults: where the surrogate's are others, a file must say so."""
_SERVOS = {"SERVO_TRIM": "SERVO{}_TRIM"}
"""Parameters that the firmware has once for each output."""
_INT16 = ("ANGLE_MAX", "MOT_PWM_MIN", "MOT_PWM_MAX", "SERVO_TRIM")
_MAVLINK_INT16, _MAVLINK_REAL32 = 4, 9
"""MAV_PARAM_TYPE of integers and of all others."""


def toml(controller: str, stages: Stages, gains: Sequence[Any], comments: Sequence[str]) -> str:
    """The ``[controller]`` table of a scenario: the name, and the gains that differ from a stage's.

    Args:
        controller: name of the stack.
        stages: its stages.
        gains: of each.
        comments: lines to stand above it.
    """
    lines = [*(f"# {line}".rstrip() for line in comments), "", "[controller]"]
    lines.append(f'name = "{controller}"')
    for stage, its in zip(stages, gains, strict=True):
        changed = differing(its, stage.gains())
        if changed:
            lines += ["", f"[controller.gains.{stage.name}]"]
            lines += [f"{name} = {value!r}" for name, value in changed.items()]
    return "\n".join(lines) + "\n"


def differing(gains: Any, default: Any) -> dict[str, float]:
    """Gains that differ from others of their kind, by name."""
    pairs = {f.name: (getattr(gains, f.name), getattr(default, f.name)) for f in fields(gains)}
    return {name: float(value) for name, (value, other) in pairs.items() if value != other}


def ardusub(gains: Sequence[Any]) -> ArduSubGains | None:
    """ArduSub's parameters among the gains of a stack, if it has any."""
    return next((its for its in gains if isinstance(its, ArduSubGains)), None)


def param(gains: ArduSubGains, thrusters: int, comments: Sequence[str]) -> str:
    """A parameter file of MAVProxy and Mission Planner: NAME,VALUE of all that differ.

    Args:
        gains: of the surrogate, in the firmware's units.
        thrusters: outputs that drive one.
        comments: lines to stand above.
    """
    named = _named(gains, thrusters)
    lines = [f"# {line}".rstrip() for line in comments]
    return "\n".join([*lines, *(f"{name},{value:g}" for name, value in named.items())]) + "\n"


def params(gains: ArduSubGains, thrusters: int, comments: Sequence[str]) -> str:
    """The same as QGroundControl writes it: system, component, name, value, type by tabs."""
    integer = {name for each in _INT16 for name in _outputs(each, thrusters)}
    lines = [f"# {line}".rstrip() for line in comments]
    for name, value in _named(gains, thrusters).items():
        kind = _MAVLINK_INT16 if name in integer else _MAVLINK_REAL32
        lines.append(f"1\t1\t{name}\t{value:g}\t{kind}")
    return "\n".join(lines) + "\n"


def _named(gains: ArduSubGains, thrusters: int) -> Mapping[str, float]:
    """Parameters that differ from the firmware's, by its names."""
    return {
        name: value
        for gain, value in differing(gains, FIRMWARE).items()
        for name in _outputs(gain, thrusters)
    }


def _outputs(gain: str, thrusters: int) -> list[str]:
    pattern = _SERVOS.get(gain)
    return [pattern.format(i + 1) for i in range(thrusters)] if pattern else [gain]
