"""Motion of all vehicles of one world, compiled to one call with minimal overhead.

The equations are those of the simulator (`angler_mjx.sim.engines.lanes.steps.physics_step`;
`angler_mjx.sim.physics.step` of vehicles with links), at the step of the lock-step. A call has
three arrays: the constants of the world, the vehicles with their last sensor state, and integer
inputs. Integers need no conversion, and keep the time exact. Where vehicles have joints, two more
say what their servos follow, and since which step.
float64: at 400 steps a second a float32 position 20 m from the origin takes steps of 1.9 um, and
a constant velocity is rounded the same way at each step, up to 0.4 mm/s beside the velocity that
the autopilot receives.
"""

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from angler_kernels import lanes, quaternion
from angler_mjx import frames
from angler_mjx.robot.control.allocation import NEUTRAL_US
from angler_mjx.robot.control.commands import ThrusterPwm
from angler_mjx.robot.control.commands.whole_body import JointTarget
from angler_mjx.robot.vehicles.link_motion import JointMotion
from angler_mjx.robot.vehicles.params import VehicleParams
from angler_mjx.sim import robot
from angler_mjx.sim.engines.lanes import steps as lane_steps
from angler_mjx.sim.physics import step as physics
from angler_mjx.sim.physics.closed_form import ClosedForm
from angler_mjx.sim.physics.step import VehicleState, Water
from angler_mjx.sim.state import FleetWorld
from angler_mjx.sim.step import joint_reference
from angler_mjx.world.currents import Current
from angler_sitl.wire.packets import STATE_NUMBERS

GRAVITY_MPS2 = 9.80665
"""Gravity that the autopilot assumes.

The simulator's own is 0.03 % more; a specific force computed with that value would not fit the
velocities that the autopilot receives."""

N_PULSES = 16
OUTCOME_COLUMN, STEPS_COLUMN = N_PULSES, N_PULSES + 1
"""Input columns behind the pulse widths: the robot's outcome, and steps since t = 0."""
N_INPUTS = N_PULSES + 2

DIVERGED_COLUMN = STATE_NUMBERS
"""Output column behind the sensor state: whether the vehicle has diverged so far."""
_VEHICLE_COLUMN = STATE_NUMBERS + 1
"""First column of the vehicle itself."""

MIN_PULSE_US, MAX_PULSE_US = 900, 2100
"""Limits of valid pulse widths; zeros while an autopilot boots, for example, are no pulse."""

SINGLE_THREAD_OPTIONS = {"xla_cpu_multi_thread_eigen": False}
"""Options of the compiler of small programs.

A change of thread takes longer than the work itself, and the autopilots need the other cores."""

type MotionStep = Callable[..., jax.Array]
"""Constants, vehicles [N, _], int32 inputs [N, INPUTS] to vehicles [N, _].

Vehicles with joints take two arrays more: a float64 array [N, 3, J] of `SceneMotion.pack_targets`,
and the int32 number of the step since which their servos follow it."""


@dataclass(frozen=True, kw_only=True)
class SceneMotion:
    """Compiled step, with the layout of its arrays."""

    step: MotionStep
    vehicles: "MotionRows"
    """Layout of one vehicle, behind its sensor state."""

    def pack_constants(self, world: FleetWorld) -> jax.Array:
        """Return the constants of a world for the step; [1] leads there."""
        return _put_on_device(_flatten((world.control.vehicle, world.environment.current)))

    def to_arrays(self, vehicles: VehicleState) -> jax.Array:
        """Return vehicles [1, N] in the form of the step, without a sensor state."""
        rows = self.vehicles.pack(vehicles)
        return _put_on_device(
            np.concatenate([np.zeros((len(rows), _VEHICLE_COLUMN)), rows], axis=1)
        )

    def pack_targets(self, target: JointTarget) -> jax.Array:
        """Return [N, 3, J] positions, speeds and accelerations of a target [1, N, J]."""
        parts = (target.position, target.velocity, target.acceleration)
        return _put_on_device(np.stack([np.asarray(part, np.float64)[0] for part in parts], axis=1))

    def extract_rows(self, rows: jax.Array) -> np.ndarray:
        """Return whether each vehicle has diverged, and the vehicle; [N, 1 + width].

        The type is JAX's default float type, as in the rest of the simulator.
        """
        return np.asarray(rows)[:, DIVERGED_COLUMN:].astype(jnp.result_type(float))


@dataclass(frozen=True, kw_only=True)
class MotionRows:
    """Layout of a tree's fields in a row."""

    tree: jax.tree_util.PyTreeDef
    shapes: tuple[tuple[int, ...], ...]

    @classmethod
    def of_vehicles(cls, vehicles: VehicleState) -> "MotionRows":
        """Return the layout of rows of vehicles [1, N, ...]."""
        leaves, structure = jax.tree.flatten(vehicles)
        return cls(tree=structure, shapes=tuple(leaf.shape[2:] for leaf in leaves))

    def pack(self, vehicles: VehicleState) -> NDArray[np.float64]:
        """Return vehicles [1, N, ...] as rows [N, width]."""
        leaves = [np.asarray(leaf, np.float64)[0] for leaf in jax.tree.leaves(vehicles)]
        return np.concatenate([leaf.reshape(len(leaf), -1) for leaf in leaves], axis=1)

    def unpack_row(self, row: jax.Array) -> VehicleState:
        """Return one traced row as one vehicle."""
        ends = itertools.pairwise(np.cumsum([0, *map(math.prod, self.shapes)]))
        parts = [row[a:b].reshape(shape) for (a, b), shape in zip(ends, self.shapes, strict=True)]
        vehicle: VehicleState = jax.tree.unflatten(self.tree, parts)
        return vehicle


def compile_motion(
    water: Water, dt_s: float, world: FleetWorld, vehicles: VehicleState
) -> SceneMotion:
    """Compile the step for worlds like this one.

    Args:
        water: the medium.
        dt_s: the step.
        world: [1] leads; another of the same scenario has the same shapes.
        vehicles: [1, N] lead.
    """
    constants_tree = (world.control.vehicle, world.environment.current)
    rows = MotionRows.of_vehicles(vehicles)
    count = vehicles.p.shape[1]

    def step(
        constants: jax.Array,
        state_rows: jax.Array,
        inputs: jax.Array,
        targets: jax.Array | None = None,
        begin: jax.Array | None = None,
    ) -> jax.Array:
        params, current = _unflatten(constants_tree, constants)
        t = inputs[0, STEPS_COLUMN].astype(state_rows.dtype) * dt_s
        references = None
        if targets is not None and begin is not None:
            elapsed = (inputs[0, STEPS_COLUMN] - begin).astype(state_rows.dtype) * dt_s
            position, velocity, acceleration = (targets[:, i] for i in range(3))
            target = JointTarget(position=position, velocity=velocity, acceleration=acceleration)
            references = joint_reference(target, elapsed)
        step_vehicle = partial(_step_vehicle, water, dt_s, rows)
        after: jax.Array = jax.vmap(step_vehicle, (0, None, 0, 0, None, 0))(
            params, current, state_rows, inputs, t, references
        )
        return after

    def step_shared(*args: jax.Array) -> jax.Array:
        (after,), _ = lanes.flatten(lanes.compute_shared(lambda: lanes.pack([step(*args)], ())))
        return after

    with jax.enable_x64(True):
        program: Callable[..., jax.Array] = step_shared
        argument_specs: tuple[jax.ShapeDtypeStruct, ...] = (
            jax.ShapeDtypeStruct(_flatten(constants_tree).shape, jnp.float64),
            jax.ShapeDtypeStruct(
                (count, _VEHICLE_COLUMN + rows.pack(vehicles).shape[1]), jnp.float64
            ),
            jax.ShapeDtypeStruct((count, N_INPUTS), jnp.int32),
        )
        if vehicles.joints is not None:  # lanes have no joints
            n_joints = vehicles.joints.position.shape[-1]
            target_specs = (
                jax.ShapeDtypeStruct((count, 3, n_joints), jnp.float64),
                jax.ShapeDtypeStruct((), jnp.int32),
            )
            program, argument_specs = step, (*argument_specs, *target_specs)
        compiled: MotionStep = (
            jax.jit(program).lower(*argument_specs).compile(SINGLE_THREAD_OPTIONS)
        )
    return SceneMotion(step=compiled, vehicles=rows)


def compute_inline() -> None:
    """Have JAX run small programs in the calling thread; for CLI commands, before any program runs.

    By default JAX hands each program to another thread and waits for it. The two changes of thread
    cost a step more than its physics, especially where autopilots keep all cores busy. The setting
    holds for the whole process, so no import makes it.
    """
    jax.config.update("jax_cpu_enable_async_dispatch", False)


def to_thruster_pwm(pulses: jax.Array, dtype: np.dtype) -> ThrusterPwm:
    """Convert pulse widths to thruster PWM; invalid pulses become neutral.

    Args:
        pulses: int32 [..., n_thruster] us, as an autopilot sends them.
        dtype: of the result.
    """
    is_pulse = (pulses >= MIN_PULSE_US) & (pulses <= MAX_PULSE_US)
    return ThrusterPwm(pwm_us=jnp.where(is_pulse, pulses, round(NEUTRAL_US)).astype(dtype))


def _compute_sensor_state(vehicle: VehicleState, acceleration: jax.Array) -> jax.Array:
    """Return the sensor state of a vehicle for its autopilot: `STATE_NUMBERS`, in NED and FRD.

    Args:
        vehicle: a single vehicle.
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
    reference: JointMotion | None,
) -> jax.Array:
    """Advance one vehicle by one step.

    The acceleration is the step's own impulse over its length: with the gravity of the autopilot,
    summed over the steps, it gives exactly the velocities that are sent. It is the base's, with
    what its links do to it.
    """
    before = rows.unpack_row(row[_VEHICLE_COLUMN:])
    pwm = to_thruster_pwm(inputs[: params.B.shape[-1]], row.dtype)
    settled, _ = robot.thrust_and_power(params, pwm)
    if reference is None:
        moved = lane_steps.physics_step(dt_s, water, params, before, settled, current, t)
    else:
        engine = ClosedForm(gravity_mps2=water.gravity_mps2)
        moved = physics.step(
            engine, params, params, before, settled, current, t, dt_s, water, reference
        )
    after, broken = robot.hold_if_ended(inputs[OUTCOME_COLUMN], before, moved)
    velocity_change = quaternion.rotate(after.q, after.nu[:3]) - quaternion.rotate(
        before.q, before.nu[:3]
    )
    leaves = [leaf.reshape(-1) for leaf in jax.tree.leaves(after)]
    flag = jnp.maximum(row[DIVERGED_COLUMN], broken.astype(row.dtype))[None]
    return jnp.concatenate([_compute_sensor_state(after, velocity_change / dt_s), flag, *leaves])


def _flatten(tree: object) -> NDArray[np.float64]:
    """Return arrays [1, ...] as one flat array."""
    leaves = [np.asarray(leaf, np.float64).reshape(-1) for leaf in jax.tree.leaves(tree)]
    return np.concatenate(leaves)


def _unflatten[T](like: T, flat: jax.Array) -> T:
    """Invert `_flatten`, without the leading axis."""
    leaves, tree = jax.tree.flatten(like)
    out, offset = [], 0
    for leaf in leaves:
        shape = leaf.shape[1:]
        size = math.prod(shape)
        part = flat[offset : offset + size].reshape(shape)
        is_integer = not jnp.issubdtype(leaf.dtype, jnp.floating)
        out.append(part.astype(leaf.dtype) if is_integer else part)
        offset += size
    unflattened: T = jax.tree.unflatten(tree, out)
    return unflattened


def _put_on_device(array: NDArray[np.float64]) -> jax.Array:
    with jax.enable_x64(True):
        on_device: jax.Array = jax.device_put(array)
    return on_device
