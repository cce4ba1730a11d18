"""Measures of sea trials, from sampled motions."""

import math
from dataclasses import dataclass

import numpy as np

from angler_mjx.robot.vehicles.thrusters import FloatArray
from angler_mjx.studies.sea_trials.actuators import Axis
from angler_mjx.studies.sea_trials.program import SAMPLE_S, TrialMotion

STEADY_FRACTION = 0.05
"""Fraction of a trial, at its end, over which a steady value is averaged."""
STEADY_TOLERANCE = 0.01
"""Range of a steady value in twice that time, as a fraction, above which it is not steady."""
REST_FRACTION = 0.05
"""Fraction of the approach speed below which a coasting vehicle counts as stopped."""
_COLUMNS: dict[Axis, int] = {"surge": 0, "sway": 1, "heave": 2, "yaw": 5}
_STILL_RADPS = 1e-4


@dataclass(frozen=True, kw_only=True)
class Measure:
    """One result."""

    trial: str
    quantity: str
    value: float
    """NaN where the vehicle does not come so far."""
    unit: str
    note: str = ""


def measure_speed(trial: str, motion: TrialMotion, axis: Axis, sign: int) -> list[Measure]:
    """Return the terminal speed along an axis, and the time to 63 % of it."""
    column = _COLUMNS[axis]
    speed = sign * motion.nu[:, column]
    steady, note = average_end(speed)
    reached = np.flatnonzero(speed >= (1.0 - math.exp(-1.0)) * steady)
    rise = motion.time_s[reached[0]] if steady > 0 and reached.size else math.nan
    if axis == "yaw":
        steady_unit, value = "deg/s", math.degrees(steady)
    else:
        steady_unit, value = "m/s", steady
    return [
        Measure(trial=trial, quantity="terminal speed", value=value, unit=steady_unit, note=note),
        Measure(trial=trial, quantity="time to 63 %", value=float(rise), unit="s"),
    ]


def measure_turn(trial: str, motion: TrialMotion, execute_s: float) -> list[Measure]:
    """Return the measures of a turning circle, from the beginning of the steering.

    Lengths are in the plane, along and across the heading at that time.
    """
    begin = round(execute_s / SAMPLE_S)
    heading = motion.yaw_rad - motion.yaw_rad[begin]
    turned = np.abs(heading[begin:])
    c, s = math.cos(motion.yaw_rad[begin]), math.sin(motion.yaw_rad[begin])
    offset = motion.p[begin:, :2] - motion.p[begin, :2]
    ahead = offset @ np.array([c, s])
    aside = np.abs(offset @ np.array([-s, c]))
    time_s = motion.time_s[begin:] - motion.time_s[begin]
    speed = _ground_speed(motion)
    approach = float(speed[begin])
    rate, rate_note = average_end(motion.nu[:, 5])
    steady_speed, speed_note = average_end(speed)
    drift = -math.atan2(average_end(motion.nu[:, 1])[0], average_end(motion.nu[:, 0])[0])
    diameter = 2.0 * steady_speed / abs(rate) if abs(rate) > _STILL_RADPS else math.nan

    def at(angle_deg: float, values: FloatArray) -> float:
        return interpolate_crossing(turned, math.radians(angle_deg), values)

    note = rate_note or speed_note
    rows = (
        ("approach speed", approach, "m/s", ""),
        ("advance", at(90, ahead), "m", ""),
        ("transfer", at(90, aside), "m", ""),
        ("tactical diameter", at(180, aside), "m", ""),
        ("time to 90 deg", at(90, time_s), "s", ""),
        ("time to 180 deg", at(180, time_s), "s", ""),
        ("steady diameter", diameter, "m", note),
        ("steady yaw rate", math.degrees(abs(rate)), "deg/s", rate_note),
        ("steady speed", steady_speed, "m/s", speed_note),
        ("drift angle", math.degrees(abs(drift)), "deg", note),
    )
    return [
        Measure(trial=trial, quantity=name, value=value, unit=unit, note=text)
        for name, value, unit, text in rows
    ]


def measure_zigzag(
    trial: str, motion: TrialMotion, execute_s: float, switch_rad: float
) -> list[Measure]:
    """Return overshoots, initial turning time and period of a zig-zag."""
    begin = round(execute_s / SAMPLE_S)
    heading = (motion.yaw_rad - motion.yaw_rad[begin])[begin:]
    sign = motion.steering[begin:]
    flips = np.flatnonzero(np.diff(sign) != 0) + 1
    overshoots = []
    for i, flip in enumerate(flips[:2]):
        end = flips[i + 1] if i + 1 < len(flips) else None
        # Steering was positive before the first reversal, and the heading goes on to that side.
        side = 1.0 if i % 2 == 0 else -1.0
        overshoots.append(math.degrees(float(np.max(side * heading[flip:end])) - switch_rad))
    overshoots += [math.nan] * (2 - len(overshoots))
    turning = interpolate_crossing(np.abs(heading), switch_rad, motion.time_s[: len(heading)])
    period = (flips[2] - flips[0]) * SAMPLE_S if len(flips) > 2 else math.nan
    rows = (
        ("initial turning time", turning, "s"),
        ("first overshoot", overshoots[0], "deg"),
        ("second overshoot", overshoots[1], "deg"),
        ("period", float(period), "s"),
    )
    return [
        Measure(trial=trial, quantity=name, value=value, unit=unit) for name, value, unit in rows
    ]


def measure_stop(
    trial: str, motion: TrialMotion, execute_s: float, *, coasts: bool
) -> list[Measure]:
    """Return track reach and time of a stop.

    Args:
        trial: its name.
        motion: of it.
        execute_s: time at which thrust ends, or is reversed.
        coasts: whether thrust ends; the vehicle then has stopped below `REST_FRACTION`.
    """
    begin = round(execute_s / SAMPLE_S)
    forward = motion.nu[begin:, 0]
    speed = _ground_speed(motion)[begin:]
    length = np.concatenate([[0.0], np.cumsum(0.5 * SAMPLE_S * (speed[1:] + speed[:-1]))])
    limit = REST_FRACTION * forward[0] if coasts else 0.0
    falling = interpolate_crossing(-forward, -limit, length)
    time = interpolate_crossing(-forward, -limit, motion.time_s[: len(forward)])
    return [
        Measure(trial=trial, quantity="approach speed", value=float(forward[0]), unit="m/s"),
        Measure(trial=trial, quantity="track reach", value=falling, unit="m"),
        Measure(trial=trial, quantity="time", value=time, unit="s"),
    ]


def measure_decay(trial: str, time_s: FloatArray, angle_rad: FloatArray) -> list[Measure]:
    """Return period and damping ratio of a free decay, from its first two peaks of one sign.

    The logarithmic decrement d between them gives the ratio d / sqrt(4 pi^2 + d^2).
    """
    angle = angle_rad - average_end(angle_rad)[0]
    inner = angle[1:-1]
    is_peak = (inner > angle[:-2]) & (inner >= angle[2:]) & (inner > 1e-3 * abs(angle[0]))
    peaks = [(float(time_s[0]), float(angle[0]))]
    peaks += [_fit_peak(time_s, angle, int(i) + 1) for i in np.flatnonzero(is_peak)]
    period = ratio = math.nan
    note = "overdamped"
    if len(peaks) > 1:
        (begin, first), (end, second) = peaks[:2]
        decrement = math.log(first / second)
        period, ratio = end - begin, decrement / math.hypot(2.0 * math.pi, decrement)
        note = ""
    below = interpolate_crossing(-np.abs(angle), -abs(angle[0]) / math.e, time_s)
    return [
        Measure(trial=trial, quantity="period", value=period, unit="s", note=note),
        Measure(trial=trial, quantity="damping ratio", value=ratio, unit="", note=note),
        Measure(trial=trial, quantity="time to 37 %", value=below, unit="s"),
    ]


def average_end(values: FloatArray) -> tuple[float, str]:
    """Return the mean over the last `STEADY_FRACTION`, and a note where it is not steady."""
    count = max(1, round(STEADY_FRACTION * len(values)))
    last, spread = float(np.mean(values[-count:])), float(np.ptp(values[-2 * count :]))
    scale = max(abs(last), 1e-6)
    return last, "" if spread < STEADY_TOLERANCE * scale else "not steady"


def interpolate_crossing(values: FloatArray, limit: float, of: FloatArray) -> float:
    """Return another quantity where values first rise to a limit; NaN if they do not."""
    above = np.flatnonzero(values >= limit)
    if not above.size:
        return math.nan
    i = int(above[0])
    if i == 0:
        return float(of[0])
    part = (limit - values[i - 1]) / (values[i] - values[i - 1])
    return float(of[i - 1] + part * (of[i] - of[i - 1]))


def _fit_peak(time_s: FloatArray, angle: FloatArray, i: int) -> tuple[float, float]:
    """Return time and height of the parabola through three samples about a peak."""
    a, b, c = (float(x) for x in angle[i - 1 : i + 2])
    bend = a - 2.0 * b + c
    shift = 0.5 * (a - c) / bend if bend else 0.0
    return float(time_s[i]) + shift * SAMPLE_S, b - 0.25 * (a - c) * shift


def _ground_speed(motion: TrialMotion) -> FloatArray:
    """Return the speed [T] in surge and sway: a vehicle that is not neutral also rises or sinks."""
    speed: FloatArray = np.hypot(motion.nu[:, 0], motion.nu[:, 1])
    return speed
