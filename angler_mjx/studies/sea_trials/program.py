"""Programs of sea trials, and their simulation in one batch.

A program is a table of commands over time. A zig-zag reverses its steering when the heading has
changed far enough. Trials follow the ITTC's procedure 7.5-04-02-01 (full scale manoeuvring trials)
with open-loop commands.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from angler_kernels import quaternion
from angler_mjx.robot.vehicles.params import VehicleParams
from angler_mjx.robot.vehicles.thrusters import FloatArray
from angler_mjx.sim.physics import step as physics
from angler_mjx.sim.physics.closed_form import ClosedForm
from angler_mjx.sim.physics.step import VehicleState, Water
from angler_mjx.studies.sea_trials.actuators import Actuators, Command, advance

DT_S = 0.01
"""Physics step, as the default of scenarios."""
SAMPLE_S = 0.02
START_M = (0.0, 0.0, -2000.0)
"""Start of every trial: far from the surface, however long a vehicle rises."""


@dataclass(frozen=True, kw_only=True)
class TrialProgram:
    """Commands of one trial."""

    commands: tuple[tuple[float, Command], ...]
    """Times of commands, s, from 0 on, and the commands, each held until the next."""
    execute_s: float = 0.0
    """Time at which the approach ends and the manoeuvre begins."""
    zigzag_by: Command | None = None
    """Steering that a zig-zag adds and reverses; None for other trials."""
    switch_rad: float = 0.0
    """Change of heading at which it is reversed."""
    roll_rad: float = 0.0
    """Angle at the start."""
    pitch_rad: float = 0.0


@dataclass(frozen=True, kw_only=True)
class TrialMotion:
    """Motion of one trial, sampled."""

    time_s: FloatArray
    """[T] from 0."""
    p: FloatArray
    """[T, 3] m in W."""
    q: FloatArray
    """[T, 4] F to W."""
    nu: FloatArray
    """[T, 6] in F."""
    steering: FloatArray
    """[T] sign of a zig-zag's steering: 1 or -1."""

    @property
    def yaw_rad(self) -> FloatArray:
        """Heading [T] about z up, unwrapped."""
        w, x, y, z = self.q.T
        yaw: FloatArray = np.unwrap(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))
        return yaw

    @property
    def roll_rad(self) -> FloatArray:
        """Roll [T]."""
        w, x, y, z = self.q.T
        roll: FloatArray = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
        return roll

    @property
    def pitch_rad(self) -> FloatArray:
        """Pitch [T]."""
        w, x, y, z = self.q.T
        pitch: FloatArray = np.arcsin(np.clip(2 * (w * y - x * z), -1.0, 1.0))
        return pitch

    @property
    def tilt_rad(self) -> FloatArray:
        """Angle [T] between the vehicle's z and the world's."""
        _, x, y, _ = self.q.T
        tilt: FloatArray = np.arccos(np.clip(1 - 2 * (x * x + y * y), -1.0, 1.0))
        return tilt


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class _Batch:
    """Programs as arrays; [n] leads."""

    time_s: jax.Array
    """[n, k] times of commands; padded with infinity."""
    command: jax.Array
    """[n, k, m]."""
    execute_s: jax.Array
    zigzag_by: jax.Array
    """[n, m]; nought of other trials."""
    switch_rad: jax.Array
    """[n]; infinite of other trials."""
    q: jax.Array
    """[n, 4] attitude at the start."""
    lower: jax.Array
    """[n, m] limits of commands."""
    upper: jax.Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class _Moment:
    """State of a trial."""

    vehicle: VehicleState
    sign: jax.Array
    yaw_rad: jax.Array
    """Heading at which the manoeuvre began."""


def simulate(
    params: VehicleParams,
    actuators: Actuators,
    programs: Sequence[TrialProgram],
    *,
    duration_s: float,
    water: Water,
) -> list[TrialMotion]:
    """Simulate trials from rest, all in one batch.

    Args:
        params: of the vehicle.
        actuators: of the vehicle; commands beyond their limits are clipped.
        programs: of the trials.
        duration_s: of each.
        water: the medium.
    """
    samples = round(duration_s / SAMPLE_S)
    batch = _stack(programs, actuators)
    p, q, nu, sign = (
        np.asarray(leaf, float)
        for leaf in _simulate_batch(params, batch, samples, round(SAMPLE_S / DT_S), water)
    )
    time_s = SAMPLE_S * np.arange(samples + 1, dtype=float)
    return [
        TrialMotion(time_s=time_s, p=p[i], q=q[i], nu=nu[i], steering=sign[i])
        for i in range(len(programs))
    ]


def _stack(programs: Sequence[TrialProgram], actuators: Actuators) -> _Batch:
    rows = max(len(program.commands) for program in programs)
    width = len(programs[0].commands[0][1])
    count = len(programs)
    time_s, command = np.full((count, rows), np.inf), np.zeros((count, rows, width))
    zigzag_by, switch_rad = np.zeros((count, width)), np.full(count, np.inf)
    attitude = np.zeros((count, 4))
    for i, program in enumerate(programs):
        for k, (begin_s, value) in enumerate(program.commands):
            time_s[i, k], command[i, k] = begin_s, value
        if program.zigzag_by is not None:
            zigzag_by[i], switch_rad[i] = program.zigzag_by, program.switch_rad
        roll, pitch = 0.5 * program.roll_rad, 0.5 * program.pitch_rad
        # Pitch after roll is not needed: a trial has one of them.
        attitude[i] = (np.cos(roll) * np.cos(pitch), np.sin(roll), np.sin(pitch), 0.0)
    return _Batch(
        time_s=jnp.asarray(time_s),
        command=jnp.asarray(command),
        execute_s=jnp.asarray([program.execute_s for program in programs]),
        zigzag_by=jnp.asarray(zigzag_by),
        switch_rad=jnp.asarray(switch_rad),
        q=jnp.asarray(attitude / np.linalg.norm(attitude, axis=1, keepdims=True)),
        lower=jnp.asarray(np.tile(actuators.lower, (count, 1))),
        upper=jnp.asarray(np.tile(actuators.upper, (count, 1))),
    )


@partial(jax.jit, static_argnums=(2, 3, 4))
def _simulate_batch(
    params: VehicleParams, batch: _Batch, samples: int, steps: int, water: Water
) -> tuple[jax.Array, ...]:
    return jax.vmap(partial(_simulate_one, params, samples=samples, steps=steps, water=water))(
        batch
    )


def _simulate_one(
    params: VehicleParams, program: _Batch, *, samples: int, steps: int, water: Water
) -> tuple[jax.Array, ...]:
    """Return p, q, nu and the sign of steering of one trial, [samples + 1] leading."""
    engine = ClosedForm(gravity_mps2=water.gravity_mps2)
    start = jnp.asarray(START_M, program.q.dtype)
    vehicle = physics.reset(engine, params, params, start, program.q, (), water)

    def advance_one(moment: _Moment, number: jax.Array) -> tuple[_Moment, None]:
        t = number.astype(program.q.dtype) * DT_S
        row = jnp.maximum(jnp.sum(program.time_s <= t + 0.5 * DT_S) - 1, 0)
        command = jnp.take(program.command, row, axis=0)
        yaw = quaternion.yaw(moment.vehicle.q)
        begun = t >= program.execute_s - 0.5 * DT_S
        first_yaw = jnp.where(begun, moment.yaw_rad, yaw)
        change = yaw - first_yaw
        change = change - 2 * jnp.pi * jnp.round(change / (2 * jnp.pi))
        turned = moment.sign * change > program.switch_rad
        sign = jnp.where(begun & turned, -moment.sign, moment.sign)
        command = command + jnp.where(begun, sign, 0.0) * program.zigzag_by
        command = jnp.clip(command, program.lower, program.upper)
        after = advance(params, moment.vehicle, command, t, DT_S, water)
        return _Moment(vehicle=after, sign=sign, yaw_rad=first_yaw), None

    def record(moment: _Moment, number: jax.Array) -> tuple[_Moment, tuple[jax.Array, ...]]:
        moment, _ = jax.lax.scan(advance_one, moment, number * steps + jnp.arange(steps))
        return moment, _sample(moment)

    first = _Moment(
        vehicle=vehicle,
        sign=jnp.ones((), program.q.dtype),
        yaw_rad=jnp.zeros((), program.q.dtype),
    )
    _, later = jax.lax.scan(record, first, jnp.arange(samples))
    return tuple(
        jnp.concatenate([begin[None], rest])
        for begin, rest in zip(_sample(first), later, strict=True)
    )


def _sample(moment: _Moment) -> tuple[jax.Array, ...]:
    vehicle = moment.vehicle
    return vehicle.p, vehicle.q, vehicle.nu, moment.sign
