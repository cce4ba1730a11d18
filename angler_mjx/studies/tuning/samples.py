"""The flights that candidates are judged by: vehicles, courses, currents and masses, by seeds.

Flights go in turn through the robots of the scenario and through three courses, so each pair, a
group, has as many as any other. Everything else of a flight is drawn from its own seed. All
candidates fly the same ones.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import jax
import numpy as np
from numpy.typing import NDArray

from angler_mjx.errors import ConfigError
from angler_mjx.robot.control.stack import ControlParams
from angler_mjx.robot.vehicles.thrusters import FloatArray
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.sim import fleet
from angler_mjx.studies.flights import courses, flying, kinds, measures, samples
from angler_mjx.studies.flights.courses import CourseTimes, FlightCourse
from angler_mjx.studies.flights.flying import FlightSettings
from angler_mjx.studies.flights.kinds import FlightKind
from angler_mjx.studies.flights.measures import ReferenceMotion
from angler_mjx.studies.flights.samples import CURRENT_MPS, MASS_ERROR, VORTEX_MPS
from angler_mjx.world.currents import Uniform, Vortices

COURSES = ("step", "hold", "eight")
"""A step of 0.5 to 2 m anywhere and of heading; standing still; Gerono's figure of eight."""
FLIGHT_S, POINT_S = 30.0, 0.5
"""Of a flight, and between the points of its course: a round of the figure of eight at 0.5 m/s,
from rest, takes 26 s."""
CURRENT_FRACTION = 0.6
"""Steady currents are also bounded by this share of a vehicle's slowest level terminal speed:
whoever is swept away tells nothing of gains."""
THRUST_ERROR = 0.3
"""Where it is asked for, thrusters push up to this share more or less than the controllers believe,
about what a battery between 12 and 18 V does. All loops gain as much: it is a gain margin."""
STEP_M = (0.5, samples.STEP_M)
SPEED_MPS, SPEED_STEP_MPS = 0.5, 0.05
"""Along the figure of eight, at most; vehicles that could not make it against the vortices go
slower, by whole steps."""
SHIFT_M = 0.5
"""Vortices lie up to this far from where the trials have them, along each axis."""
OFF_M = 0.01
"""From where it should be to where a flight begins: guidance asks how far a vehicle is behind, and
a distance of 0 has no derivative."""
TRAIN, HELD_OUT = 0, 1


@dataclass(frozen=True, kw_only=True)
class TunedRobots:
    """What flies: the distinct robots of a scenario that something holds level."""

    labels: tuple[str, ...]
    params: ControlParams
    """[n_robot] leads."""
    eight_mps: tuple[float, ...]
    """Speed of each along the figure of eight."""
    left_out: tuple[str, ...]
    """Those that nothing holds level."""


@dataclass(frozen=True, kw_only=True)
class FlightSet:
    """A set of flights, on the host."""

    settings: FlightSettings
    reference: ReferenceMotion
    group: NDArray[np.int64]
    """int [n] of each flight: robot * 3 + course."""


def select_robots(scenario: Scenario) -> TunedRobots:
    """The distinct robots of a scenario (host side).

    Raises:
        ConfigError: nothing holds any of them level: no gains would.
    """
    members = scenario.members()
    variants = fleet.list_variants(members)
    built = fleet.build_fleet(members, multibody=False)
    possible = np.isfinite(np.asarray(built.log_weight))
    cruise = np.where(possible, np.asarray(built.cruise_mps, float), 0.0).max(axis=0)
    names = [f"{v.vehicle}, {v.parameter_set}" for v in variants]
    labels = [
        f"{name} ({v.battery_v:g} V)" if names.count(name) > 1 else name
        for name, v in zip(names, variants, strict=True)
    ]
    loose = [
        FlightKind(vehicle=v.vehicle, parameter_set=v.parameter_set) in kinds.find_unstabilised()
        for v in variants
    ]
    rows = [i for i, bad in enumerate(loose) if not bad]
    left_out = tuple(label for label, bad in zip(labels, loose, strict=True) if bad)
    if not rows:
        raise ConfigError(f"scenario {scenario.name}: nothing holds {'; '.join(left_out)} level")
    on_host = jax.tree.map(np.asarray, built.control)
    params = replace(kinds.select_rows(on_host, rows), cruise_speed_mps=cruise[rows])
    able = samples.min_terminal_speed_mps(params.vehicle)
    speeds = [
        max(_round_speed(min(SPEED_MPS, cruise[row], 0.9 * max_mps - VORTEX_MPS)), SPEED_STEP_MPS)
        for row, max_mps in zip(rows, able, strict=True)
    ]
    return TunedRobots(
        labels=tuple(labels[row] for row in rows),
        params=params,
        eight_mps=tuple(speeds),
        left_out=left_out,
    )


def _round_speed(speed_mps: float) -> float:
    return round(math.floor(speed_mps / SPEED_STEP_MPS + 1e-9) * SPEED_STEP_MPS, 6)


@dataclass(frozen=True, kw_only=True)
class _FlightSample:
    """What the seed of a flight says."""

    step_m: FloatArray
    """[3]."""
    off_m: FloatArray
    """[3] of the start."""
    yaw_rad: float
    current: FloatArray
    """[3] of unit greatest length, in W."""
    vortex_mps: float
    shift_m: FloatArray
    turn: float
    mass: float
    thrust: float
    """-1 to 1, of the greatest error."""


def _sample_flight(seed: int, part: int, number: int) -> _FlightSample:
    rng = np.random.default_rng([seed, part, number])
    direction = rng.normal(size=3)
    course = rng.uniform(-math.pi, math.pi)
    return _FlightSample(
        step_m=rng.uniform(*STEP_M) * samples.unit_vector(direction),
        off_m=-OFF_M * samples.unit_vector(direction),
        yaw_rad=rng.uniform(-math.pi, math.pi),
        current=samples.level_velocity(rng.uniform(0.0, 1.0), course),
        vortex_mps=rng.uniform(0.0, VORTEX_MPS),
        shift_m=rng.uniform(-SHIFT_M, SHIFT_M, 2),
        turn=float(rng.choice([-1.0, 1.0])),
        mass=1.0 + rng.uniform(-MASS_ERROR, MASS_ERROR),
        thrust=rng.uniform(-1.0, 1.0),
    )


def sample_flights(
    robots: TunedRobots,
    n: int,
    seed: int,
    part: int,
    dt: float,
    *,
    timed: bool,
    thrust_error: float = 0.0,
) -> FlightSet:
    """The flights of a seed (host side).

    Args:
        robots: the robots.
        n: number of flights.
        seed: of the tuning.
        part: ``TRAIN`` or ``HELD_OUT``: other flights altogether.
        dt: control period, s.
        timed: whether the controllers keep time and take headings; those that do not are told
            paths at cruise speed, steps too, and their heading does not count.
        thrust_error: greatest share of thrust more or less than the controllers believe.
    """
    n_robot = len(robots.labels)
    rows = [i % n_robot for i in range(n)]
    kind = [COURSES[i // n_robot % len(COURSES)] for i in range(n)]
    flight_samples = [_sample_flight(seed, part, i) for i in range(n)]
    params = kinds.select_rows(robots.params, rows)
    eights = np.array([name == "eight" for name in kind])
    times = CourseTimes(flight_s=FLIGHT_S, point_s=POINT_S, dt_s=dt)
    cruise = np.asarray(robots.params.cruise_speed_mps, float)
    flight_courses = [
        _build_course(sample, name, robots.eight_mps[row], float(cruise[row]), times, timed)
        for sample, name, row in zip(flight_samples, kind, rows, strict=True)
    ]
    bound = (
        np.minimum(CURRENT_MPS, CURRENT_FRACTION * samples.min_terminal_speed_mps(params.vehicle))
        * ~eights
    )
    current = bound[:, None] * np.array([sample.current for sample in flight_samples])
    heading = np.array([course.pose[0, 3] for course in flight_courses])
    return FlightSet(
        settings=FlightSettings(
            params=params,
            plant=samples.perturb_vehicle(
                params.vehicle,
                np.array([sample.mass for sample in flight_samples]),
                1.0 + thrust_error * np.array([sample.thrust for sample in flight_samples]),
            ),
            start_m=flying.start_positions(n)
            + np.array([sample.off_m for sample in flight_samples]),
            yaw_rad=np.where(eights, heading, 0.0),
            command=courses.build_command(flight_courses, timed=timed),
            current=(Uniform(velocity_mps=current), _build_vortices(flight_samples, eights)),
        ),
        reference=measures.build_reference(flight_courses, heading=timed),
        group=np.array(
            [row * len(COURSES) + COURSES.index(x) for row, x in zip(rows, kind, strict=True)]
        ),
    )


def _build_course(
    sample: _FlightSample,
    kind: str,
    eight_mps: float,
    cruise_mps: float,
    times: CourseTimes,
    timed: bool,
) -> FlightCourse:
    """The course of a flight."""
    if kind == "eight":
        return courses.follow_eight(eight_mps, times)
    step = sample.step_m if kind == "step" else np.zeros(3)
    if timed:
        return courses.hold_position(step, sample.yaw_rad if kind == "step" else 0.0, times)
    return courses.follow_line(step, cruise_mps, times)


def _build_vortices(flight_samples: Sequence[_FlightSample], eights: FloatArray) -> Vortices:
    """Those of the trials, of drawn strength and sense, shifted; none but for eights."""
    max_mps = np.array(
        [sample.vortex_mps * on for sample, on in zip(flight_samples, eights, strict=True)]
    )
    unshifted: Vortices = jax.tree.map(np.asarray, samples.build_vortices(max_mps))
    shift = np.array([sample.shift_m for sample in flight_samples])
    turn = np.array([sample.turn for sample in flight_samples])
    return replace(
        unshifted,
        centre_m=unshifted.centre_m + shift[:, None, :],
        circulation_m2ps=unshifted.circulation_m2ps * turn[:, None],
    )
