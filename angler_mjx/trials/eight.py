"""The figure of eight: how far from it each controller is, in still water and against odds."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np

from angler_kernels.current_field import lamb_oseen_circulation
from angler_mjx.trials import courses, flying, kinds
from angler_mjx.trials.courses import Course
from angler_mjx.trials.flying import Orders
from angler_mjx.trials.kinds import Kind
from angler_mjx.vehicles.params import VehicleParams
from angler_mjx.vehicles.thrusters import FloatArray
from angler_mjx.world import currents
from angler_mjx.world.currents import Vortices

SPEED_MPS, SLOW_MPS = 0.5, 0.3
"""Along the course; the slow one for sets that cannot make 0.5 m/s against the vortices."""
SLOW_SETS = ("von_benzon2022",)
FLIGHT_S = 60.0
"""Two rounds and a half at 0.5 m/s."""
VORTEX_MPS = 0.4
"""Greatest speed of the water over the course."""
MASS_ERROR = 0.2
CONDITIONS = (
    ("still", 0.0, 0.0),
    ("vortices, 20 % heavier", VORTEX_MPS, MASS_ERROR),
    ("vortices, 20 % lighter", VORTEX_MPS, -MASS_ERROR),
)
"""Name, greatest speed of the water, and mass and inertia of the vehicle as a share above what the
controllers believe; its volume is as they believe, so it sinks or rises."""
_CENTRES_M = np.array([[-1.6, 1.0], [0.2, -1.2], [1.8, 0.8]])
_CORES_M = np.array([1.2, 1.5, 1.2])
_TURNS = np.array([1.0, -1.0, 1.0])


@dataclass(frozen=True, kw_only=True)
class Eight:
    """What came of one figure of eight."""

    kind: Kind
    condition: str
    speed_mps: float
    in_time_m: float
    """RMS distance to where the course is at the time, from the start at rest to the end; nan for
    a controller that does not keep time."""
    across_m: float
    """RMS distance to the nearest point of the course."""
    track_m: FloatArray
    """[t, 2] flown, x and y from the centre of the figure."""
    course_m: FloatArray
    """[t, 2] what was to be flown."""

    @property
    def error_m(self) -> float:
        """In time where the controller keeps time, across the path where it does not."""
        return self.across_m if math.isnan(self.in_time_m) else self.in_time_m


def fly(controller: str, vehicles: Sequence[Kind]) -> tuple[Eight, ...]:
    """Fly the figure of eight with some vehicles, in all conditions."""
    spec = kinds.spec_of(controller)
    timed = kinds.keeps_time(spec)
    cases = list(itertools.product(range(len(vehicles)), CONDITIONS))
    rows = [row for row, _ in cases]
    speeds = [_speed(vehicles[row], condition) for row, (condition, _, _) in cases]
    make = courses.timed_command if timed else courses.path_command
    told = [_courses(speed, spec.control_dt_s) for speed in speeds]
    params = kinds.chosen(kinds.build(vehicles), rows)
    heavier = jnp.asarray([1.0 + error for _, (_, _, error) in cases], float)
    orders = Orders(
        params=params,
        plant=_with_mass(params.vehicle, heavier),
        gains=flying.same_gains(spec, len(cases)),
        yaw_rad=jnp.asarray([coarse.position[0, 3] for coarse, _ in told], float),
        command=courses.stacked([make(coarse) for coarse, _ in told]),
        current=(vortices(np.array([flow for _, (_, flow, _) in cases])),),
    )
    n_step = round(FLIGHT_S / spec.control_dt_s)
    track = flying.track(spec, flying.program(spec, n_step)(orders))
    out = []
    for i, (row, (condition, _, _)) in enumerate(cases):
        wanted = told[i][1].position[:n_step, :3]
        position = track.position_m[i]
        out.append(
            Eight(
                kind=vehicles[row],
                condition=condition,
                speed_mps=speeds[i],
                in_time_m=_rms(position - wanted) if timed else math.nan,
                across_m=_rms(position - _nearest(position, wanted)),
                track_m=position[:, :2],
                course_m=wanted[:, :2],
            )
        )
    return tuple(out)


def _speed(kind: Kind, condition: str) -> float:
    slow = kind.parameter_set in SLOW_SETS and condition != CONDITIONS[0][0]
    return SLOW_MPS if slow else SPEED_MPS


@cache
def _courses(speed_mps: float, period_s: float) -> tuple[Course, Course]:
    """The course at the points that are commanded, and at every control step."""
    n = round(FLIGHT_S / courses.POINT_S) + 1
    fine = round(FLIGHT_S / period_s) + 1
    return (
        courses.figure_of_eight(speed_mps, n),
        courses.figure_of_eight(speed_mps, fine, period_s),
    )


def _with_mass(vehicle: VehicleParams, share: jax.Array) -> VehicleParams:
    """Vehicles [n] of other mass and inertia, by a share [n]."""
    return replace(
        vehicle,
        mass_kg=vehicle.mass_kg * share,
        inertia_kgm2=vehicle.inertia_kgm2 * share[:, None, None],
    )


def vortices(most_mps: FloatArray) -> Vortices:
    """Three vortices that turn either way, for each of n greatest speeds over the course."""
    unit = Vortices(
        centre_m=jnp.asarray(_CENTRES_M, float),
        circulation_m2ps=jnp.asarray(
            _TURNS * np.asarray(lamb_oseen_circulation(jnp.ones(3), jnp.asarray(_CORES_M))), float
        ),
        core_m=jnp.asarray(_CORES_M, float),
    )
    a = np.linspace(0.0, 2 * np.pi, 721)
    line = courses.HALF_WIDTH_M * np.stack([np.sin(a), 0.5 * np.sin(2 * a), 0 * a], axis=1)
    at = jnp.asarray(line, float)
    flow = jax.vmap(currents.velocity, (None, 0, None))((unit,), at, jnp.zeros((), at.dtype))
    share = jnp.asarray(most_mps / float(jnp.linalg.norm(flow, axis=1).max()), float)
    n = len(most_mps)
    return Vortices(
        centre_m=jnp.tile(unit.centre_m, (n, 1, 1)),
        circulation_m2ps=share[:, None] * unit.circulation_m2ps,
        core_m=jnp.tile(unit.core_m, (n, 1)),
    )


def _rms(off: FloatArray) -> float:
    """Root of the mean square length of errors [t, 3]."""
    return float(np.sqrt(np.mean(np.sum(off**2, axis=1))))


def _nearest(position: FloatArray, path: FloatArray) -> FloatArray:
    """Points [t, 3] of a path [n, 3] nearest to positions [t, 3], on the lines between its rows."""
    start, step = path[:-1], np.diff(path, axis=0)
    long = np.maximum(np.sum(step**2, axis=1), 1e-12)
    from_start = position[:, None, :] - start
    share = np.clip(np.sum(from_start * step, axis=2) / long, 0.0, 1.0)
    points = start + share[..., None] * step
    best = np.argmin(np.sum((position[:, None, :] - points) ** 2, axis=2), axis=1)
    nearest: FloatArray = points[np.arange(len(position)), best]
    return nearest
