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

PULSES = 16
OUTCOME, STEPS = PULSES, PULSES + 1
"""Columns of the input behind the pulse widths: the robot's outcome, and steps since t = 0."""
INPUTS = PULSES + 2

BROKEN = STATE_NUMBERS
"""Column of the output behind what is sent: whether the vehicle has diverged so far."""
_KEPT_FROM = STATE_NUMBERS + 1
"""First column of the vehicle itself."""

LOW_US, HIGH_US = 900, 2100
"""Pulse widths outside, above all the zeros while an autopilot boots, are no pulse at all."""

ONE_THREAD = {"xla_cpu_multi_thread_eigen": False}
"""For the compiler of small programs: to hand a part to another thread takes longer than the part,
and the autopilots need the other cores."""

type Step = Callable[[jax.Array, jax.Array, NDArray[np.int32]], jax.Array]
"""Constants, vehicles [N, _], int32 inputs [N, INPUTS] to vehicles [N, _]."""


@dataclass(frozen=True, kw_only=True)
class SceneMotion:
    """The compiled step, and where things lie in its arrays."""

    step: Step
    vehicles: "MotionRows"
    """Of one vehicle, behind what is said of it."""

    def constants(self, world: World) -> jax.Array:
        """What a step has to know of a world; [1] leads there."""
        return _on_device(_flat((world.control.vehicle, world.environment.current)))

    def begin(self, vehicles: VehicleState) -> jax.Array:
        """Vehicles [1, N] as the step takes them, with nothing said of them yet."""
        rows = self.vehicles.pack(vehicles)
        return _on_device(np.concatenate([np.zeros((len(rows), _KEPT_FROM)), rows], axis=1))

    def told(self, rows: jax.Array) -> NDArray[Any]:
        """Whether each vehicle has diverged, and the vehicle; [N, 1 + width].

        Of JAX's default float type, in which the rest of the simulator is.
        """
        return np.asarray(rows)[:, BROKEN:].astype(jnp.result_type(float))


@dataclass(frozen=True, kw_only=True)
class MotionRows:
    """Where the fields of a tree lie in a row."""

    tree: Any
    shapes: tuple[tuple[int, ...], ...]

    @classmethod
    def of(cls, tree: Any) -> "MotionRows":
        """Rows of arrays [1, N, ...]."""
        leaves, structure = jax.tree.flatten(tree)
        return cls(tree=structure, shapes=tuple(leaf.shape[2:] for leaf in leaves))

    def pack(self, tree: Any) -> NDArray[np.float64]:
        """Arrays [1, N, ...] as rows [N, width]."""
        leaves = [np.asarray(leaf, np.float64)[0] for leaf in jax.tree.leaves(tree)]
        return np.concatenate([leaf.reshape(len(leaf), -1) for leaf in leaves], axis=1)

    def split(self, row: jax.Array) -> Any:
        """One traced row as the tree of one vehicle."""
        ends = itertools.pairwise(np.cumsum([0, *map(math.prod, self.shapes)]))
        parts = [row[a:b].reshape(shape) for (a, b), shape in zip(ends, self.shapes, strict=True)]
        return jax.tree.unflatten(self.tree, parts)


def build(water: Water, dt_s: float, world: World, vehicles: VehicleState) -> SceneMotion:
    """Compile the step for worlds like this one.

    Args:
        water: the medium.
        dt_s: the step.
        world: [1] leads; another of the same scenario has the same shapes.
        vehicles: [1, N] lead.
    """
    given = (world.control.vehicle, world.environment.current)
    rows = MotionRows.of(vehicles)
    count = vehicles.p.shape[1]

    def step(constants: jax.Array, now: jax.Array, inputs: jax.Array) -> jax.Array:
        params, current = _unflat(given, constants)
        t = inputs[0, STEPS].astype(now.dtype) * dt_s
        one = partial(_move, water, dt_s, rows)
        after: jax.Array = jax.vmap(one, (0, None, 0, 0, None))(params, current, now, inputs, t)
        return after

    def shared(*args: jax.Array) -> Any:
        return lanes.shared(lambda: lanes.pack([step(*args)], ()))[()]

    with jax.enable_x64(True):
        like = (
            jax.ShapeDtypeStruct(_flat(given).shape, jnp.float64),
            jax.ShapeDtypeStruct((count, _KEPT_FROM + rows.pack(vehicles).shape[1]), jnp.float64),
            jax.ShapeDtypeStruct((count, INPUTS), jnp.int32),
        )
        compiled: Step = jax.jit(shared).lower(*like).compile(ONE_THREAD)
    return SceneMotion(step=compiled, vehicles=rows)


def compute_inline() -> None:
    """Have JAX run small programs in the thread that calls them; for commands, before any is run.

    Otherwise it hands each to a thread of its own and waits for it: two changes of thread that cost
    a step more than its physics, the more so where autopilots keep all cores busy. It is a setting
    of the whole process, hence not made by importing anything.
    """
    jax.config.update("jax_cpu_enable_async_dispatch", False)


def signals(pulses: jax.Array, dtype: Any) -> ThrusterPwm:
    """Pulse widths as thrusters take them: what is no pulse is neutral.

    Args:
        pulses: int32 [..., n_thruster] us, as an autopilot sends them.
        dtype: of the result.
    """
    is_pulse = (pulses >= LOW_US) & (pulses <= HIGH_US)
    return ThrusterPwm(pwm_us=jnp.where(is_pulse, pulses, round(NEUTRAL_US)).astype(dtype))


def _said(vehicle: VehicleState, acceleration: jax.Array) -> jax.Array:
    """What an autopilot is told of its vehicle: `STATE_NUMBERS`, in NED and FRD.

    Args:
        vehicle: one.
        acceleration: [3] of its centre of mass, m/s^2, in W.
    """
    lift = acceleration + jnp.array([0.0, 0.0, GRAVITY_MPS2], acceleration.dtype)
    specific_force = quaternion.rotate_inverse(vehicle.q, lift)
    velocity = quaternion.rotate(vehicle.q, vehicle.nu[:3])
    parts = [
        frames.body_flu_to_frd(vehicle.nu[3:]),
        frames.body_flu_to_frd(specific_force),
        frames.vector_enu_to_ned(vehicle.p),
        frames.quaternion_enu_to_ned(vehicle.q),
        frames.vector_enu_to_ned(velocity),
    ]
    return jnp.concatenate(parts)


def _move(
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
    before: VehicleState = rows.split(row[_KEPT_FROM:])
    pwm = signals(inputs[: params.B.shape[-1]], row.dtype)
    settled, _ = robot.thrust_and_power(params, pwm)
    moved = lane_steps.physics_step(dt_s, water, params, before, settled, current, t)
    after, broken = robot.hold_if_ended(inputs[OUTCOME], before, moved)
    gained = quaternion.rotate(after.q, after.nu[:3]) - quaternion.rotate(before.q, before.nu[:3])
    kept = [leaf.reshape(-1) for leaf in jax.tree.leaves(after)]
    flag = jnp.maximum(row[BROKEN], broken.astype(row.dtype))[None]
    return jnp.concatenate([_said(after, gained / dt_s), flag, *kept])


def _flat(tree: Any) -> NDArray[np.float64]:
    """Arrays [1, ...] in a row."""
    leaves = [np.asarray(leaf, np.float64).reshape(-1) for leaf in jax.tree.leaves(tree)]
    return np.concatenate(leaves)


def _unflat(like: Any, flat: jax.Array) -> Any:
    """The inverse of `_flat`, without the leading axis."""
    leaves, tree = jax.tree.flatten(like)
    out, at = [], 0
    for leaf in leaves:
        shape = leaf.shape[1:]
        size = math.prod(shape)
        part = flat[at : at + size].reshape(shape)
        whole = not jnp.issubdtype(leaf.dtype, jnp.floating)
        out.append(part.astype(leaf.dtype) if whole else part)
        at += size
    return jax.tree.unflatten(tree, out)


def _on_device(array: NDArray[np.float64]) -> jax.Array:
    with jax.enable_x64(True):
        placed: jax.Array = jax.device_put(array)
    return placed
