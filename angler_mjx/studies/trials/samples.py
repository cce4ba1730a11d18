"""Robustness: random vehicles, batteries, currents and gains; each draw is known by its seed.

A draw is a parameter set, a battery from 12 to 18 V, a steady level current of up to 0.8 m/s from
anywhere, every gain 20 % up or down, and a step of up to 2 m and half a turn. Seeds are the numbers
from 0 on, so any draw can be flown again alone.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields

import jax
import jax.numpy as jnp
import numpy as np

from angler_mjx.robot.control.laws.ardusub.gains import ArduSubGains
from angler_mjx.robot.control.stack import ControlParams, StackGains
from angler_mjx.robot.vehicles.thrusters import FloatArray
from angler_mjx.sim.state import SimSpec
from angler_mjx.studies.flights import courses, flying, kinds, samples, tracks
from angler_mjx.studies.flights.flying import FlightSettings
from angler_mjx.studies.flights.kinds import FlightKind
from angler_mjx.studies.flights.measures import RATE_RADPS, TILT_RAD
from angler_mjx.studies.flights.samples import CURRENT_MPS, STEP_M
from angler_mjx.studies.flights.tracks import FlightTrack
from angler_mjx.world.currents import Uniform

BATTERY_V = (12.0, 18.0)
BATTERY_STEP_V = 0.1
"""Batteries are drawn in steps: each is a thrust table, interpolated once."""
GAIN_FRACTION = 0.2
"""Gains are multiplied by 1 - this to 1 + this, each by its own number."""
FLIGHT_S = 40.0
LAST_S = 10.0
CHUNK = 250
"""Draws in one device call: few enough to stay in a processor's cache."""
QUIET_RADPS = 0.5
"""At the end, over ``LAST_S``, the vehicle turns no faster than this."""
STATION_M = 0.5
"""Nearer than this over ``LAST_S`` a vehicle keeps station."""
OUTRUN_FRACTION = 0.8
"""A vehicle that does not keep station is outrun if the current has more than this share of its
slowest level terminal speed: little thrust is left for anything else."""
_N_GAIN = 64
"""Numbers drawn for gains; more than any stack has."""


@dataclass(frozen=True, kw_only=True)
class TrialSample:
    """One draw."""

    seed: int
    kind: FlightKind
    battery_v: float
    current_mps: FloatArray
    """[3] in W."""
    step_m: FloatArray
    """[3] from the start, in W."""
    yaw_rad: float
    """Heading wanted; the vehicle begins with 0."""
    gain_factors: FloatArray
    """[64] factors of the gains of whatever stack, in their order."""


@dataclass(frozen=True, kw_only=True)
class TrialVerdict:
    """What came of one draw."""

    sample: TrialSample
    tilt_rad: float
    """Greatest of the flight."""
    rate_radps: float
    """Greatest of the flight."""
    end_rate_radps: float
    """Greatest over ``LAST_S``."""
    distance_m: float
    """Greatest distance from the target over ``LAST_S``."""
    able_mps: float
    """Slowest level terminal speed of the vehicle, with its battery."""

    @property
    def fault(self) -> str:
        """Why attitude or rates are not bounded; empty if they are."""
        if not math.isfinite(self.tilt_rad + self.rate_radps + self.distance_m):
            return "diverges"
        if self.tilt_rad > TILT_RAD:
            return f"leans {math.degrees(self.tilt_rad):.0f} degrees"
        if self.rate_radps > RATE_RADPS:
            return f"turns at {self.rate_radps:.1f} rad/s"
        if self.end_rate_radps > QUIET_RADPS:
            return f"still turns at {self.end_rate_radps:.1f} rad/s"
        return ""

    @property
    def outcome(self) -> str:
        """``failed``, ``station``, ``outrun`` by the current, or ``away`` from its target."""
        if self.fault:
            return "failed"
        if self.distance_m <= STATION_M:
            return "station"
        speed = float(np.linalg.norm(self.sample.current_mps))
        return "outrun" if speed > OUTRUN_FRACTION * self.able_mps else "away"


@dataclass(frozen=True, kw_only=True)
class _VehicleTable:
    """Vehicles with their batteries, built once."""

    params: ControlParams
    """[n] leads; on the host."""
    row: dict[tuple[FlightKind, float], int]
    """Of each vehicle with each battery."""


def sample_trial(seed: int) -> TrialSample:
    """The draw of a seed (host side)."""
    rng = np.random.default_rng(seed)
    vehicles = kinds.shipped_vehicles()
    kind = vehicles[int(rng.integers(len(vehicles)))]
    steps = round((BATTERY_V[1] - BATTERY_V[0]) / BATTERY_STEP_V)
    volts = BATTERY_V[0] + BATTERY_STEP_V * int(rng.integers(steps + 1))
    speed, course = rng.uniform(0.0, CURRENT_MPS), rng.uniform(-math.pi, math.pi)
    direction = rng.normal(size=3)
    step = rng.uniform(0.0, STEP_M) * samples.unit_vector(direction)
    return TrialSample(
        seed=seed,
        kind=kind,
        battery_v=round(volts, 6),
        current_mps=samples.level_velocity(speed, course),
        step_m=step,
        yaw_rad=rng.uniform(-math.pi, math.pi),
        gain_factors=rng.uniform(1.0 - GAIN_FRACTION, 1.0 + GAIN_FRACTION, _N_GAIN),
    )


def gains_of(spec: SimSpec, factors: FloatArray) -> StackGains:
    """The gains of a stack for n robots, each scaled by its own share [n, 64].

    Settings that say what the vehicle is, not how hard to steer it, stay as they are: of ArduSub's
    parameters only P, I and D change.
    """
    at, out = 0, []
    for gains in spec.gains:
        scaled = {}
        for entry in fields(gains):
            value = getattr(gains, entry.name)
            changes = not isinstance(gains, ArduSubGains) or entry.name[-2:] in ("_P", "_I", "_D")
            changes &= not entry.name.startswith("fin_")  # no robot of the study has fins
            factor = factors[:, at] if changes else np.ones(len(factors))
            scaled[entry.name] = jnp.asarray(value * factor, float)
            at += changes
        out.append(type(gains)(**scaled))
    return tuple(out)


def fly_samples(
    controller: str, seeds: Sequence[int], done: Callable[[int], None] = lambda _: None
) -> Iterator[TrialVerdict]:
    """Fly draws with a controller, chunk by chunk.

    Args:
        controller: name of the stack.
        seeds: of the draws.
        done: told the number of draws after each chunk.
    """
    spec = kinds.spec_of(controller)
    n_step = round(FLIGHT_S / spec.control_dt_s)
    program = flying.build_program(spec, n_step)
    if not seeds:
        return
    trial_samples = [sample_trial(seed) for seed in seeds]
    vehicle_table = _build_vehicles(trial_samples)
    for first in range(0, len(trial_samples), CHUNK):
        chunk = trial_samples[first : first + CHUNK]
        # The last chunk is filled up, so that the program is compiled once.
        full = chunk + chunk[:1] * (min(CHUNK, len(seeds)) - len(chunk))
        settings = _build_settings(spec, vehicle_table, full)
        gains = gains_of(spec, np.array([sample.gain_factors for sample in full]))
        able = samples.min_terminal_speed_mps(settings.plant)
        track = tracks.build_track(spec, program(settings, gains))
        last = round(LAST_S / spec.control_dt_s)
        for i, sample in enumerate(chunk):
            yield _judge_flight(sample, track, i, last, float(able[i]))
        done(len(chunk))


def _build_settings(
    spec: SimSpec, vehicle_table: _VehicleTable, chunk: Sequence[TrialSample]
) -> FlightSettings:
    params = kinds.select_rows(
        vehicle_table.params, [vehicle_table.row[sample.kind, sample.battery_v] for sample in chunk]
    )
    steps, yaws = (
        np.array([sample.step_m for sample in chunk]),
        np.array([sample.yaw_rad for sample in chunk]),
    )
    flows = jnp.asarray(np.array([sample.current_mps for sample in chunk]), float)
    return FlightSettings(
        params=params,
        plant=params.vehicle,
        start_m=flying.start_positions(len(chunk)),
        yaw_rad=jnp.zeros(len(chunk)),
        command=kinds.build_command(spec, steps, yaws),
        current=(Uniform(velocity_mps=flows),),
    )


def _build_vehicles(trial_samples: Sequence[TrialSample]) -> _VehicleTable:
    """What all draws need; each vehicle with each battery once."""
    rows = list(dict.fromkeys((sample.kind, sample.battery_v) for sample in trial_samples))
    built = kinds.build_params([kind for kind, _ in rows], [volt for _, volt in rows])
    on_host: ControlParams = jax.tree.map(np.asarray, built)
    return _VehicleTable(params=on_host, row={row: i for i, row in enumerate(rows)})


def _judge_flight(
    sample: TrialSample, track: FlightTrack, i: int, last: int, able_mps: float
) -> TrialVerdict:
    end = track.position_m[i, -last:]
    off = np.linalg.norm(end - courses.START_M - sample.step_m, axis=1)
    return TrialVerdict(
        sample=sample,
        tilt_rad=float(track.tilt_rad[i].max()),
        rate_radps=float(track.rate_radps[i].max()),
        end_rate_radps=float(track.rate_radps[i, -last:].max()),
        distance_m=float(off.max()),
        able_mps=able_mps,
    )
