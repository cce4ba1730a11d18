"""Tuned gains as files: a table for scenarios, and parameters for ArduSub."""

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import TYPE_CHECKING

from angler_mjx.robot.control.laws.ardusub.gains import ArduSubGains
from angler_mjx.robot.control.stack import Stages

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

FIRMWARE_DEFAULTS = ArduSubGains(WPNAV_SPEED=1000.0)
"""The firmware's own defaults: where the surrogate's are others, a file must say so."""
_SERVOS = {"SERVO_TRIM": "SERVO{}_TRIM"}
"""Parameters that the firmware has once for each output."""
_INT16 = ("ANGLE_MAX", "MOT_PWM_MIN", "MOT_PWM_MAX", "SERVO_TRIM")
_MAVLINK_INT16, _MAVLINK_REAL32 = 4, 9
"""MAV_PARAM_TYPE of integers and of all others."""


def format_toml(
    controller: str, stages: Stages, gains: Sequence["DataclassInstance"], comments: Sequence[str]
) -> str:
    """The ``[controller]`` table of a scenario: the name, and the gains that differ from a stage's.

    Args:
        controller: name of the stack.
        stages: its stages.
        gains: of each.
        comments: lines to stand above it.
    """
    lines = [*(f"# {line}".rstrip() for line in comments), "", "[controller]"]
    lines.append(f'name = "{controller}"')
    for stage, stage_gains in zip(stages, gains, strict=True):
        changed = find_changed_gains(stage_gains, stage.gains())
        if changed:
            lines += ["", f"[controller.gains.{stage.name}]"]
            lines += [f"{name} = {value!r}" for name, value in changed.items()]
    return "\n".join(lines) + "\n"


def find_changed_gains(
    gains: "DataclassInstance", default: "DataclassInstance"
) -> dict[str, float]:
    """Gains that differ from others of their kind, by name."""
    pairs = {f.name: (getattr(gains, f.name), getattr(default, f.name)) for f in fields(gains)}
    return {name: float(value) for name, (value, other) in pairs.items() if value != other}


def find_ardusub_gains(gains: Sequence[object]) -> ArduSubGains | None:
    """ArduSub's parameters among the gains of a stack, if it has any."""
    return next(
        (stage_gains for stage_gains in gains if isinstance(stage_gains, ArduSubGains)), None
    )


def format_param_file(gains: ArduSubGains, thrusters: int, comments: Sequence[str]) -> str:
    """A parameter file of MAVProxy and Mission Planner: NAME,VALUE of all that differ.

    Args:
        gains: of the surrogate, in the firmware's units.
        thrusters: outputs that drive one.
        comments: lines to stand above.
    """
    named = _changed_parameters(gains, thrusters)
    lines = [f"# {line}".rstrip() for line in comments]
    return "\n".join([*lines, *(f"{name},{value:g}" for name, value in named.items())]) + "\n"


def format_params_file(gains: ArduSubGains, thrusters: int, comments: Sequence[str]) -> str:
    """The same as QGroundControl writes it: system, component, name, value, type by tabs."""
    integer = {name for each in _INT16 for name in _output_names(each, thrusters)}
    lines = [f"# {line}".rstrip() for line in comments]
    for name, value in _changed_parameters(gains, thrusters).items():
        kind = _MAVLINK_INT16 if name in integer else _MAVLINK_REAL32
        lines.append(f"1\t1\t{name}\t{value:g}\t{kind}")
    return "\n".join(lines) + "\n"


def _changed_parameters(gains: ArduSubGains, thrusters: int) -> Mapping[str, float]:
    """Parameters that differ from the firmware's, by its names."""
    return {
        name: value
        for gain, value in find_changed_gains(gains, FIRMWARE_DEFAULTS).items()
        for name in _output_names(gain, thrusters)
    }


def _output_names(gain: str, thrusters: int) -> list[str]:
    pattern = _SERVOS.get(gain)
    return [pattern.format(i + 1) for i in range(thrusters)] if pattern else [gain]
