"""Which gains of a stack are tuned, within which bounds, and how they are written as numbers.

A knob is the natural logarithm of a factor on one gain, or on several that move together; 0 is the
gain that the search began with. A factor is positive, so no gain can change its sign.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp

from angler_mjx.errors import ConfigError
from angler_mjx.robot.control.laws.ardusub.gains import ArduSubGains
from angler_mjx.robot.control.stack import StackGains
from angler_mjx.sim.state import SimSpec

SPAN = 6.0
"""A gain is at most this many times the one it began with, or that part of it."""
DIGITS = 4
"""Significant digits of a tuned gain."""

TUNED_GAINS: Mapping[str, tuple[tuple[str, ...], ...]] = {
    "los": (("lookahead_m",), ("integral_per_s",), ("position_per_s",), ("attitude_per_s",)),
    "pose": (("position_per_s",), ("attitude_per_s",)),
    "pid_pose": (("position_per_s",), ("attitude_per_s",)),
    "velocity": (("velocity_per_s",), ("rate_per_s",), ("integral_per_s2",)),
    "pid_velocity": (
        ("velocity_per_s",),
        ("rate_per_s",),
        ("velocity_integral_per_s2",),
        ("rate_integral_per_s2",),
    ),
    "ismc": (
        ("velocity_per_s",),
        ("rate_per_s",),
        ("sliding_mps2",),
        ("sliding_radps2",),
        ("layer_mps",),
        ("layer_radps",),
    ),
    "aitsm": (
        ("terminal",),
        ("reaching_per_s",),
        ("sliding_least", "sliding_most"),
        ("adaptation",),
        ("leak_per_s",),
        ("layer",),
    ),
    "tracking": (
        ("position_per_s",),
        ("attitude_per_s",),
        ("velocity_per_s",),
        ("rate_per_s",),
        ("integral_per_s2",),
    ),
    "computed_torque": (
        ("position_per_s",),
        ("velocity_per_s",),
        ("attitude_per_s",),
        ("rate_per_s",),
        ("integral_per_s2",),
    ),
    "ardusub": (
        ("PSC_POSXY_P",),
        ("PSC_VELXY_P",),
        ("PSC_VELXY_I",),
        ("PSC_POSZ_P",),
        ("PSC_VELZ_P",),
        ("PSC_ACCZ_P",),
        ("PSC_ACCZ_I",),
        ("ATC_ANG_RLL_P", "ATC_ANG_PIT_P"),
        ("ATC_ANG_YAW_P",),
        ("ATC_RAT_RLL_P", "ATC_RAT_PIT_P"),
        ("ATC_RAT_RLL_I", "ATC_RAT_PIT_I"),
        ("ATC_RAT_RLL_D", "ATC_RAT_PIT_D"),
        ("ATC_RAT_YAW_P",),
        ("ATC_RAT_YAW_I",),
    ),
}
"""By stage; those in one bracket keep their ratio. Limits, filters and what a mission asks for
(speeds, rates of turn, lags) are not tuned: they say what a vehicle may do, not how well."""

RANGES: Mapping[str, tuple[float, float]] = {
    "PSC_POSXY_P": (0.5, 2.0),
    "PSC_VELXY_P": (0.1, 6.0),
    "PSC_VELXY_I": (0.02, 1.0),
    "PSC_POSZ_P": (1.0, 3.0),
    "PSC_VELZ_P": (1.0, 8.0),
    "PSC_ACCZ_P": (0.2, 1.5),
    "PSC_ACCZ_I": (0.0, 3.0),
    "ATC_ANG_RLL_P": (3.0, 12.0),
    "ATC_ANG_PIT_P": (3.0, 12.0),
    "ATC_ANG_YAW_P": (3.0, 12.0),
    "ATC_RAT_RLL_P": (0.0, 0.3),
    "ATC_RAT_RLL_I": (0.0, 0.5),
    "ATC_RAT_RLL_D": (0.0, 0.02),
    "ATC_RAT_PIT_P": (0.0, 0.3),
    "ATC_RAT_PIT_I": (0.0, 0.5),
    "ATC_RAT_PIT_D": (0.0, 0.02),
    "ATC_RAT_YAW_P": (0.0, 0.5),
    "ATC_RAT_YAW_I": (0.0, 0.05),
}
"""Ranges that ArduSub documents for its parameters; ground stations warn outside them."""


@dataclass(frozen=True, kw_only=True)
class Knob:
    """One number that is searched for."""

    stage: str
    gains: tuple[str, ...]
    """Names of the gains that it turns."""
    start: tuple[float, ...]
    """Their values at 0."""
    low: float
    """Least value of the knob, 0 or below."""
    high: float
    """Greatest value, 0 or above."""

    @property
    def label(self) -> str:
        """As tables name it."""
        return f"{self.stage}.{' and '.join(self.gains)}"

    def values(self, turn: float) -> tuple[float, ...]:
        """Its gains at a setting, to the digits that are written."""
        return tuple(float(f"{x * math.exp(turn):.{DIGITS}g}") for x in self.start)


def build_knobs(spec: SimSpec) -> tuple[Knob, ...]:
    """The knobs of a stack, about its gains.

    A gain of 0 has no logarithm: it is left as it is.

    Raises:
        ConfigError: the stack has no gain that is tuned.
    """
    knobs = []
    for stage, gains in zip(spec.stages, spec.gains, strict=True):
        for names in TUNED_GAINS.get(stage.name, ()):
            start = tuple(float(getattr(gains, name)) for name in names)
            if all(x > 0 for x in start):
                low, high = _knob_bounds(names if isinstance(gains, ArduSubGains) else (), start)
                knobs.append(Knob(stage=stage.name, gains=names, start=start, low=low, high=high))
    if not knobs:
        names_of = ", ".join(stage.name for stage in spec.stages)
        raise ConfigError(f"stages {names_of}: none of their gains can be tuned")
    return tuple(knobs)


def _knob_bounds(ranged: Sequence[str], start: Sequence[float]) -> tuple[float, float]:
    """Least and greatest setting; gains that begin outside their range may stay there."""
    low, high = -math.log(SPAN), math.log(SPAN)
    for name, value in zip(ranged, start, strict=False):
        range_low, range_high = RANGES[name]
        if range_low > 0:
            low = max(low, min(0.0, math.log(range_low / value)))
        high = min(high, max(0.0, math.log(range_high / value)))
    return low, high


def apply_settings(spec: SimSpec, knobs: Sequence[Knob], settings: jax.Array) -> StackGains:
    """The gains of all stages at settings [n_knob] of the knobs; may be traced."""
    changed: dict[str, dict[str, jax.Array]] = {}
    for i, knob in enumerate(knobs):
        for name, start in zip(knob.gains, knob.start, strict=True):
            changed.setdefault(knob.stage, {})[name] = start * jnp.exp(settings[i])
    return tuple(
        replace(gains, **changed.get(stage.name, {}))
        for stage, gains in zip(spec.stages, spec.gains, strict=True)
    )


def round_settings(knobs: Sequence[Knob], settings: Sequence[float]) -> list[float]:
    """Settings whose gains are those that are written, by the first gain of each knob."""
    return [
        min(max(math.log(knob.values(turn)[0] / knob.start[0]), knob.low), knob.high)
        for knob, turn in zip(knobs, settings, strict=True)
    ]
