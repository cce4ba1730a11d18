"""Motion of all vehicles of one world, compiled to one call with minimal overhead.

The equations are those of the simulator (`angler_mjx.sim.engines.lanes.steps.physics_step`;
`angler_mjx.sim.physics.step` of vehicles with links), at the step of the lock-step. A call has
three arrays: the constants of the world, the vehicles with their last sensor state, and integer
inputs. Integers need no conversion, and keep the time exact. Where vehicles have joints, two more
say what their servos follow, and since which step. Where bodies touch, obstacles and grips move in
the same steps (`angler_sitl.scene.contact_motion`) and are one array more.
float64: at 400 steps a second a float32 position 20 m from the origin takes steps of 1.9 um, and
a constant velocity is rounded the same way at each step, up to 0.4 mm/s beside the velocity that
the autopilot receives.
"""

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
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
from angler_mjx.sim.impacts import Impacts, no_impacts
from angler_mjx.sim.physics import step as physics
from angler_mjx.sim.physics.closed_form import ClosedForm
from angler_mjx.sim.physics.contact.grips import Grips
from angler_mjx.sim.physics.step import VehicleState, Water
from angler_mjx.sim.state import FleetWorld, WorldState
from angler_mjx.sim.step import joint_reference
from angler_mjx.world.currents import Current
from angler_mjx.world.obstacles import ObstacleState
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
VEHICLE_COLUMN = STATE_NUMBERS + 1
"""First column of the vehicle itself."""

MIN_PULSE_US, MAX_PULSE_US = 900, 2100
"""Limits of valid pulse widths; zeros while an autopilot boots, for example, are no pulse."""

SINGLE_THREAD_OPTIONS = {"xla_cpu_multi_thread_eigen": False}
"""Options of the compiler of small programs.

A change of thread takes longer than the work itself, and the autopilots need the other cores."""

type MotionArrays = tuple[jax.Array, ...]
"""Vehicles [N, _] behind their sensor states; where bodies touch, the flat `ContactBodies` too."""

type MotionStep = Callable[..., MotionArrays]
"""Constants, what moves, int32 inputs [N, INPUTS] to what has moved.

Vehicles with joints take two arrays more: a float64 array [N, 3, J] of `SceneMotion.pack_targets`,
and the int32 number of the step since which their servos follow it."""


@dataclass(frozen=True, kw_only=True)
class SceneMotion:
    """Compiled step, with the layout of its arrays."""

    step: MotionStep
    vehicles: "MotionRows"
    """Layout of one vehicle, behind its sensor state."""
    select_constants: Callable[[FleetWorld], object]
    """Parts of a world that the step needs; [1] leads."""
    bodies: "ContactBodies | None" = None
    """Bodies of a world like the simulated ones, [1] leading; None where nothing touches."""

    def pack_constants(self, world: FleetWorld) -> jax.Array:
        """Return the constants of a world for the step; [1] leads there."""
        return put_on_device(flatten_tree(self.select_constants(world)))

    def to_arrays(self, state: WorldState) -> MotionArrays:
        """Return what moves of a state [1] in the form of the step, without sensor states."""
        rows = self.vehicles.pack(state.vehicles)
        rows = np.concatenate([np.zeros((len(rows), VEHICLE_COLUMN)), rows], axis=1)
        arrays = (put_on_device(rows),)
        if self.bodies is None:
            return arrays
        return (*arrays, put_on_device(flatten_tree(ContactBodies.of_state(state))))

    def pack_targets(self, target: JointTarget) -> jax.Array:
        """Return [N, 3, J] positions, speeds and accelerations of a target [1, N, J]."""
        parts = (target.position, target.velocity, target.acceleration)
        return put_on_device(np.stack([np.asarray(part, np.float64)[0] for part in parts], axis=1))

    def extract_rows(self, arrays: MotionArrays) -> np.ndarray:
        """Return whether each vehicle has diverged, and the vehicle; [N, 1 + width].

        The type is JAX's default float type, as in the rest of the simulator.
        """
        return np.asarray(arrays[0])[:, DIVERGED_COLUMN:].astype(jnp.result_type(float))

    def extract_bodies(self, arrays: MotionArrays) -> np.ndarray:
        """Return the flat `ContactBodies`, of that type too; empty where nothing touches."""
        if self.bodies is None:
            return np.zeros(0, jnp.result_type(float))
        return np.asarray(arrays[1]).astype(jnp.result_type(float))

    def replace_grips(self, arrays: MotionArrays, grips: Grips | None) -> MotionArrays:
        """Return what moves with other grips, [1] leading; as it is where robots hold nothing."""
        if self.bodies is None or grips is None:
            return arrays
        one: ContactBodies = unflatten_tree(self.bodies, np.asarray(arrays[1]))
        bodies = jax.tree.map(lambda leaf: np.asarray(leaf)[None], replace(one, grips=None))
        return arrays[0], put_on_device(flatten_tree(replace(bodies, grips=grips)))

    def unpack_bodies(self, flat: jax.Array) -> "ContactBodies | None":
        """Return the bodies of one world from their traced flat form."""
        return None if self.bodies is None else unflatten_tree(self.bodies, flat)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class ContactBodies:
    """What moves with the vehicles of one world where bodies touch."""

    obstacles: ObstacleState
    grips: Grips | None
    """None where robots hold nothing."""
    impacts: Impacts
    """Hardest of the robots since the last judgement."""

    @classmethod
    def of_state(cls, state: WorldState) -> "ContactBodies":
        """Return the bodies of a state [1], before any impact."""
        robots, dtype = state.vehicles.p.shape[1], state.vehicles.p.dtype
        none = no_impacts(robots, dtype, holds=state.grips is not None)
        return cls(
            obstacles=state.obstacles,
            grips=state.grips,
            impacts=jax.tree.map(lambda x: x[None], none),
        )


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
    constants_tree = select_vehicle_constants(world)
    rows = MotionRows.of_vehicles(vehicles)

    def step(
        constants: jax.Array,
        arrays: MotionArrays,
        inputs: jax.Array,
        targets: jax.Array | None = None,
        begin: jax.Array | None = None,
    ) -> MotionArrays:
        params, current = unflatten_tree(constants_tree, constants)
        (state_rows,) = arrays
        t = inputs[0, STEPS_COLUMN].astype(state_rows.dtype) * dt_s
        references = find_joint_reference(inputs, targets, begin, dt_s)
        step_vehicle = partial(_step_vehicle, water, dt_s, rows)
        after: jax.Array = jax.vmap(step_vehicle, (0, None, 0, 0, None, 0))(
            params, current, state_rows, inputs, t, references
        )
        return (after,)

    def step_shared(constants: jax.Array, arrays: MotionArrays, inputs: jax.Array) -> MotionArrays:
        packed, _ = lanes.flatten(
            lanes.compute_shared(lambda: lanes.pack([*step(constants, arrays, inputs)], ()))
        )
        return tuple(packed)

    program = step_shared if vehicles.joints is None else step  # lanes have no joints
    moving = (rows.pack(vehicles).shape[1],)
    compiled = compile_step(program, constants_tree, vehicles, moving)
    return SceneMotion(step=compiled, vehicles=rows, select_constants=select_vehicle_constants)


def select_vehicle_constants(world: FleetWorld) -> tuple[VehicleParams, Current]:
    """Return what the steps of vehicles that touch nothing need; [1] leads."""
    return world.control.vehicle, world.environment.current


def find_joint_reference(
    inputs: jax.Array, targets: jax.Array | None, begin: jax.Array | None, dt_s: float
) -> JointMotion | None:
    """Return what the servos [N, J] hold in a step; None where no vehicle has joints.

    Args:
        inputs: int32 [N, INPUTS] of the step.
        targets: [N, 3, J] of `SceneMotion.pack_targets`.
        begin: int32 [] step since which they are followed.
        dt_s: the step.
    """
    if targets is None or begin is None:
        return None
    elapsed = (inputs[0, STEPS_COLUMN] - begin).astype(targets.dtype) * dt_s
    position, velocity, acceleration = (targets[:, i] for i in range(3))
    target = JointTarget(position=position, velocity=velocity, acceleration=acceleration)
    return joint_reference(target, elapsed)


def compile_step(
    program: MotionStep,
    constants: object,
    vehicles: VehicleState,
    widths: tuple[int, ...],
) -> MotionStep:
    """Compile a step in float64.

    Args:
        program: traceable step.
        constants: tree of its constants, [1] leading.
        vehicles: [1, N] lead.
        widths: number of columns of a vehicle, and of numbers of the bodies where any touch.
    """
    count = vehicles.p.shape[1]
    with jax.enable_x64(True):
        arrays = tuple(
            jax.ShapeDtypeStruct(shape, jnp.float64)
            for shape in ((count, VEHICLE_COLUMN + widths[0]), *((n,) for n in widths[1:]))
        )
        argument_specs: tuple[object, ...] = (
            jax.ShapeDtypeStruct(flatten_tree(constants).shape, jnp.float64),
            arrays,
            jax.ShapeDtypeStruct((count, N_INPUTS), jnp.int32),
        )
        if vehicles.joints is not None:
            n_joints = vehicles.joints.position.shape[-1]
            argument_specs = (
                *argument_specs,
                jax.ShapeDtypeStruct((count, 3, n_joints), jnp.float64),
                jax.ShapeDtypeStruct((), jnp.int32),
            )
        lowered = jax.jit(program).lower(*argument_specs)
        compiled: MotionStep = lowered.compile(SINGLE_THREAD_OPTIONS)
    return compiled


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
    before = rows.unpack_row(row[VEHICLE_COLUMN:])
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
    return pack_row(before, after, row[DIVERGED_COLUMN], broken, dt_s)


def pack_row(
    before: VehicleState,
    after: VehicleState,
    diverged: jax.Array,
    broken: jax.Array,
    dt_s: float,
) -> jax.Array:
    """Return the row of one vehicle after a step.

    Args:
        before: vehicle before the step.
        after: vehicle after it.
        diverged: [] whether it had diverged before.
        broken: bool [] whether it diverged in the step.
        dt_s: the step.
    """
    velocity_change = quaternion.rotate(after.q, after.nu[:3]) - quaternion.rotate(
        before.q, before.nu[:3]
    )
    leaves = [leaf.reshape(-1) for leaf in jax.tree.leaves(after)]
    flag = jnp.maximum(diverged, broken.astype(diverged.dtype))[None]
    return jnp.concatenate([_compute_sensor_state(after, velocity_change / dt_s), flag, *leaves])


def flatten_tree(tree: object) -> NDArray[np.float64]:
    """Return arrays [1, ...] as one flat array."""
    leaves = [np.asarray(leaf, np.float64).reshape(-1) for leaf in jax.tree.leaves(tree)]
    return np.concatenate(leaves)


def unflatten_tree[T](like: T, flat: jax.Array | np.ndarray) -> T:
    """Invert `flatten_tree`, without the leading axis."""
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


def put_on_device(array: NDArray[np.float64]) -> jax.Array:
    """Return a float64 array on the device."""
    with jax.enable_x64(True):
        on_device: jax.Array = jax.device_put(array)
    return on_device
