"""Motion of all vehicles of one world, compiled to one call with as little around it as can be.

The equations are those of the simulator (`angler_mjx.sim.engines.lanes.steps.physics_step`), at the
step of the lock-step. Around them a call has three arrays: the constants of the world, the vehicles
with what was last sent of them, and whole numbers from outside. They are whole so that they need no
conversion, and the time is exact. float64: at 400 steps a second a float32 position 20 m from the
origin takes steps of 1.9 um, and a constant velocity is rounded the same way at each of them, up to
0.4 mm/s beside the velocity that the autopilot is told.
"""

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from angler_kernels import lanes, quaternion
from angler_mjx import frames
from angler_mjx.robot.control.allocation import NEUTRAL_US
from angler_mjx.robot.control.commands import ThrusterPwm
from angler_mjx.robot.vehicles.params import VehicleParams
from angler_mjx.sim import robot
from angler_mjx.sim.engines.lanes import steps as lane_steps
from angler_mjx.sim.physics.step import VehicleState, Water
from angler_mjx.sim.state import World
from angler_mjx.world.currents import Current
from angler_sitl.wire.packets import STATE_NUMBERS

GRAVITY_MPS2 = 9.80665
"""What the autopilot takes for its weight. The simulator's own is 0.03 % more; a specific force
made with that one would not fit the velocities that it is told."""

N_PULSES = 16
OUTCOME_COLUMN, STEPS_COLUMN = N_PULSES, N_PULSES + 1
"""Columns of the input behind the pulse widths: the robot's outcome, and steps since t = 0."""
N_INPUTS = N_PULSES + 2

DIVERGED_COLUMN = STATE_NUMBERS
"""Column of the output behind what is sent: whether the vehicle has diverged so far."""
_VEHICLE_COLUMN = STATE_NUMBERS + 1
"""First column of the vehicle itself."""

MIN_PULSE_US, MAX_PULSE_US = 900, 2100
"""Pulse widths outside, above all the zeros while an autopilot boots, are no pulse at all."""

SINGLE_THREAD_OPTIONS = {"xla_cpu_multi_thread_eigen": False}
"""For the compiler of small programs: to hand a part to another thread takes longer than the part,
and the autopilots need the other cores."""

type MotionStep = Callable[[jax.Array, jax.Array, NDArray[np.int32]], jax.Array]
"""Constants, vehicles [N, _], int32 inputs [N, INPUTS] to vehicles [N, _]."""


@dataclass(frozen=True, kw_only=True)
class SceneMotion:
    """The compiled step, and where things lie in its arrays."""

    step: MotionStep
    vehicles: "MotionRows"
    """Of one vehicle, behind what is said of it."""

    def pack_constants(self, world: World) -> jax.Array:
        """What a step has to know of a world; [1] leads there."""
        return _put_on_device(_flatten((world.control.vehicle, world.environment.current)))

    def to_arrays(self, vehicles: VehicleState) -> jax.Array:
        """Vehicles [1, N] as the step takes them, with nothing said of them yet."""
        rows = self.vehicles.pack(vehicles)
        return _put_on_device(
            np.concatenate([np.zeros((len(rows), _VEHICLE_COLUMN)), rows], axis=1)
        )

    def extract_rows(self, rows: jax.Array) -> NDArray[Any]:
        """Whether each vehicle has diverged, and the vehicle; [N, 1 + width].

        Of JAX's default float type, in which the rest of the simulator is.
        """
        return np.asarray(rows)[:, DIVERGED_COLUMN:].astype(jnp.result_type(float))


@dataclass(frozen=True, kw_only=True)
class MotionRows:
    """Where the fields of a tree lie in a row."""

    tree: Any
    shapes: tuple[tuple[int, ...], ...]

    @classmethod
    def from_tree(cls, tree: Any) -> "MotionRows":
        """Rows of arrays [1, N, ...]."""
        leaves, structure = jax.tree.flatten(tree)
        return cls(tree=structure, shapes=tuple(leaf.shape[2:] for leaf in leaves))

    def pack(self, tree: Any) -> NDArray[np.float64]:
        """Arrays [1, N, ...] as rows [N, width]."""
        leaves = [np.asarray(leaf, np.float64)[0] for leaf in jax.tree.leaves(tree)]
        return np.concatenate([leaf.reshape(len(leaf), -1) for leaf in leaves], axis=1)

    def unpack_row(self, row: jax.Array) -> Any:
        """One traced row as the tree of one vehicle."""
        ends = itertools.pairwise(np.cumsum([0, *map(math.prod, self.shapes)]))
        parts = [row[a:b].reshape(shape) for (a, b), shape in zip(ends, self.shapes, strict=True)]
        return jax.tree.unflatten(self.tree, parts)


def compile_motion(water: Water, dt_s: float, world: World, vehicles: VehicleState) -> SceneMotion:
    """Compile the step for worlds like this one.

    Args:
        water: the medium.
        dt_s: the step.
        world: [1] leads; another of the same scenario has the same shapes.
        vehicles: [1, N] lead.
    """
    constants_tree = (world.control.vehicle, world.environment.current)
    rows = MotionRows.from_tree(vehicles)
    count = vehicles.p.shape[1]

    def step(constants: jax.Array, state_rows: jax.Array, inputs: jax.Array) -> jax.Array:
        params, current = _unflatten(constants_tree, constants)
        t = inputs[0, STEPS_COLUMN].astype(state_rows.dtype) * dt_s
        step_vehicle = partial(_step_vehicle, water, dt_s, rows)
        after: jax.Array = jax.vmap(step_vehicle, (0, None, 0, 0, None))(
            params, current, state_rows, inputs, t
        )
        return after

    def step_shared(*args: jax.Array) -> Any:
        return lanes.compute_shared(lambda: lanes.pack([step(*args)], ()))[()]

    with jax.enable_x64(True):
        argument_specs = (
            jax.ShapeDtypeStruct(_flatten(constants_tree).shape, jnp.float64),
            jax.ShapeDtypeStruct(
                (count, _VEHICLE_COLUMN + rows.pack(vehicles).shape[1]), jnp.float64
            ),
            jax.ShapeDtypeStruct((count, N_INPUTS), jnp.int32),
        )
        compiled: MotionStep = (
            jax.jit(step_shared).lower(*argument_specs).compile(SINGLE_THREAD_OPTIONS)
        )
    return SceneMotion(step=compiled, vehicles=rows)


def compute_inline() -> None:
    """Have JAX run small programs in the thread that calls them; for commands, before any is run.

    Otherwise it hands each to a thread of its own and waits for it: two changes of thread that cost
    a step more than its physics, the more so where autopilots keep all cores busy. It is a setting
    of the whole process, hence not made by importing anything.
    """
    jax.config.update("jax_cpu_enable_async_dispatch", False)


def to_thruster_pwm(pulses: jax.Array, dtype: Any) -> ThrusterPwm:
    """Pulse widths as thrusters take them: what is no pulse is neutral.

    Args:
        pulses: int32 [..., n_thruster] us, as an autopilot sends them.
        dtype: of the result.
    """
    is_pulse = (pulses >= MIN_PULSE_US) & (pulses <= MAX_PULSE_US)
    return ThrusterPwm(pwm_us=jnp.where(is_pulse, pulses, round(NEUTRAL_US)).astype(dtype))


def _compute_sensor_state(vehicle: VehicleState, acceleration: jax.Array) -> jax.Array:
    """What an autopilot is told of its vehicle: `STATE_NUMBERS`, in NED and FRD.

    Args:
        vehicle: one.
        acceleration: [3] of its centre of mass, m/s^2, in W.
    """
    proper_acceleration = acceleration + jnp.array([0.0, 0.0, GRAVITY_MPS2], acceleration.dtype)
    specific_force = quaternion.rotate_inverse(vehicle.q, proper_acceleration)
    velocity = quaternion.rotate(vehicle.q, vehicle.nu[:3])
    parts = [
        frames.body_flu_to_frd(vehicle.nu[3:]),
        frames.body_flu_to_frd(specific_force),
        frames.vector_enu_to_ned(vehicle.p),
        frames.quaternion_enu_to_ned(vehicle.q),
        frames.vector_enu_to_ned(velocity),
    ]
    return jnp.concatenate(parts)


def _step_vehicle(
    water: Water,
    dt_s: float,
    rows: MotionRows,
    params: VehicleParams,
    current: Current,
    row: jax.Array,
    inputs: jax.Array,
    t: jax.Array,
) -> jax.Array:
    """One step of one vehicle.

    The acceleration is the step's own impulse over its length: it and the gravity of the autopilot,
    summed over the steps, give the velocities that are sent, with nothing left over.
    """
    before: VehicleState = rows.unpack_row(row[_VEHICLE_COLUMN:])
    pwm = to_thruster_pwm(inputs[: params.B.shape[-1]], row.dtype)
    settled, _ = robot.thrust_and_power(params, pwm)
    moved = lane_steps.physics_step(dt_s, water, params, before, settled, current, t)
    after, broken = robot.hold_if_ended(inputs[OUTCOME_COLUMN], before, moved)
    velocity_change = quaternion.rotate(after.q, after.nu[:3]) - quaternion.rotate(
        before.q, before.nu[:3]
    )
    leaves = [leaf.reshape(-1) for leaf in jax.tree.leaves(after)]
    flag = jnp.maximum(row[DIVERGED_COLUMN], broken.astype(row.dtype))[None]
    return jnp.concatenate([_compute_sensor_state(after, velocity_change / dt_s), flag, *leaves])


def _flatten(tree: Any) -> NDArray[np.float64]:
    """Arrays [1, ...] in a row."""
    leaves = [np.asarray(leaf, np.float64).reshape(-1) for leaf in jax.tree.leaves(tree)]
    return np.concatenate(leaves)


def _unflatten(like: Any, flat: jax.Array) -> Any:
    """The inverse of `_flatten`, without the leading axis."""
    leaves, tree = jax.tree.flatten(like)
    out, offset = [], 0
    for leaf in leaves:
        shape = leaf.shape[1:]
        size = math.prod(shape)
        part = flat[offset : offset + size].reshape(shape)
        is_integer = not jnp.issubdtype(leaf.dtype, jnp.floating)
        out.append(part.astype(leaf.dtype) if is_integer else part)
        offset += size
    return jax.tree.unflatten(tree, out)


def _put_on_device(array: NDArray[np.float64]) -> jax.Array:
    with jax.enable_x64(True):
        on_device: jax.Array = jax.device_put(array)
    return on_device
