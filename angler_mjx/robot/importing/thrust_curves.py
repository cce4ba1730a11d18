"""Curves of single thrusters: conversions of UUV Simulator, and limits of thrust.

UUV Simulator clamps a command, multiplies it by a gain and an efficiency, converts it to a thrust,
and clamps the thrust. Its command has no PWM: neutral is the command 0, and PWM is linear in the
command to its limits on either side.
"""

import numpy as np

from angler_mjx.errors import format_value
from angler_mjx.robot.importing.foreign_vehicle import ThrusterMount
from angler_mjx.robot.importing.notes import Notes
from angler_mjx.robot.importing.numbers import round_vector
from angler_mjx.robot.importing.xml_tree import Element
from angler_mjx.robot.vehicles.checks import PWM_HIGH_US, PWM_LOW_US
from angler_mjx.robot.vehicles.thruster_config import ThrusterTable
from angler_mjx.robot.vehicles.thrusters import PWM_GRID_US, FloatArray, tables_at

CURVE_PWM_US = np.arange(PWM_LOW_US, PWM_HIGH_US + 1, 25)
"""Signals at which curves are written."""
_NEUTRAL_US = (PWM_LOW_US + PWM_HIGH_US) / 2


def read_conversion(plugin: Element, conversion: Element, notes: Notes) -> FloatArray | None:
    """Return the thrust [n] at `CURVE_PWM_US` by the conversion of a thruster, N.

    None where the file does not say enough; the list then says so.
    """
    numbers = ", ".join(f"{c.tag} = {' '.join(c.text.split())}" for c in conversion.read().children)
    what = f"conversion of thrusters ({numbers})"
    limits = _find_command_limits(plugin, conversion)
    if limits is None:
        notes.add(
            "dropped",
            f"{what}: the thruster file has the thrust, for clampMin and clampMax below and above "
            "0 are not stated",
            conversion.location,
        )
        return None
    low, high = limits
    fraction = (CURVE_PWM_US - _NEUTRAL_US) / (PWM_HIGH_US - _NEUTRAL_US)
    command = np.where(fraction < 0, -low * fraction, high * fraction)
    command *= _number(plugin, "gain", 1.0) * _efficiency(plugin, "propeller_efficiency")
    thrust = _convert(conversion, command)
    if thrust is None:
        notes.add("dropped", f"{what}: of a type that is not known", conversion.location)
        return None
    thrust = thrust * _efficiency(plugin, "thrust_efficiency")
    thrust = np.clip(
        thrust, _number(plugin, "thrustMin", -np.inf), _number(plugin, "thrustMax", np.inf)
    )
    if np.any(np.diff(thrust) < 0) or not thrust[0] < 0 < thrust[-1]:
        notes.add(
            "dropped",
            f"{what}: thrust does not rise with the command, from astern to ahead",
            conversion.location,
        )
        return None
    notes.add(
        "converted",
        f"{what}: curve of each thruster, with PWM linear in the command from {low:g} to {high:g}; "
        "power is that of the thruster file at the same thrust",
        conversion.location,
    )
    return thrust


def limit_thrust(
    mount: ThrusterMount, thruster: ThrusterTable, voltage_v: float, notes: Notes
) -> FloatArray | None:
    """Return the thrust [n] at `CURVE_PWM_US` of a thruster file within the limits of a thruster.

    None where it states none, or none that the thruster file reaches; the list then says so.
    """
    limits = [x for x in (mount.min_thrust_n, mount.max_thrust_n) if x is not None]
    if not limits:
        return None
    volts = min(max(voltage_v, thruster.voltage_v[0]), thruster.voltage_v[-1])
    table, _ = tables_at(thruster, volts)
    low = table[0] if mount.min_thrust_n is None else mount.min_thrust_n
    high = table[-1] if mount.max_thrust_n is None else mount.max_thrust_n
    what = f"limits of thrust {', '.join(f'{x:g} N' for x in limits)}"
    file = f"thruster {thruster.name} gives {table[0]:.1f} to {table[-1]:.1f} N"
    if not low < 0 < high or (low <= table[0] and high >= table[-1]):
        notes.add("dropped", f"{what}: {file}", mount.element.location)
        return None
    notes.add(
        "converted",
        f"{what}: curve of the thruster, cut there; {file} at {volts:g} V",
        mount.element.location,
    )
    thrust: FloatArray = np.clip(np.interp(CURVE_PWM_US, PWM_GRID_US, table), low, high)
    return thrust


def curve_table(thrust_n: FloatArray) -> dict[str, list[int] | list[float]]:
    """Return the table of a curve in a vehicle file."""
    return {"pwm_us": CURVE_PWM_US.tolist(), "thrust_n": round_vector(thrust_n, 6)}


def _find_command_limits(plugin: Element, conversion: Element) -> tuple[float, float] | None:
    """Return the least and greatest command; None where they are not on both sides of 0."""
    low, high = _number(plugin, "clampMin", np.nan), _number(plugin, "clampMax", np.nan)
    points = conversion.find("inputValues")
    if points is not None:
        # Beyond its points a table is flat.
        values = [float(x) for x in points.text.split()]
        scale = _number(plugin, "gain", 1.0) * _efficiency(plugin, "propeller_efficiency")
        if scale > 0 and values:
            low = min(values) / scale if np.isnan(low) else low
            high = max(values) / scale if np.isnan(high) else high
    return (low, high) if low < 0 < high else None


def _convert(conversion: Element, command: FloatArray) -> FloatArray | None:
    """Return the thrust [n] of commands [n] by a <conversion>; None for unknown types."""
    kind = conversion.find("type")
    squared = command * np.abs(command)
    match None if kind is None else kind.text.strip():
        case "Basic":
            return _require(conversion, "rotorConstant") * squared
        case "Bessa":
            left, right = _require(conversion, "deltaL"), _require(conversion, "deltaR")
            astern = _require(conversion, "rotorConstantL") * np.minimum(squared - left, 0.0)
            ahead = _require(conversion, "rotorConstantR") * np.maximum(squared - right, 0.0)
            return astern + ahead
        case "LinearInterp":
            points = [conversion.find(tag) for tag in ("inputValues", "outputValues")]
            rows = [[] if row is None else [float(x) for x in row.text.split()] for row in points]
            if not rows[0] or len(rows[0]) != len(rows[1]):
                conversion.fail("needs as many outputValues as inputValues, and one at least")
            order = np.argsort(rows[0])
            at, value = (np.array(row)[order] for row in rows)
            thrust: FloatArray = np.interp(command, at, value)
            return thrust
    return None


def _require(conversion: Element, tag: str) -> float:
    element = conversion.find(tag)
    if element is None:
        conversion.fail(f"has no {format_value(tag)}; add it")
    return element.number()


def _number(plugin: Element, tag: str, default: float) -> float:
    element = plugin.find(tag)
    return default if element is None else element.number()


def _efficiency(plugin: Element, tag: str) -> float:
    """Return an efficiency; 1 where it is not within 0 to 1, as UUV Simulator takes it."""
    value = _number(plugin, tag, 1.0)
    return value if 0.0 <= value <= 1.0 else 1.0
