"""Motion of a free vehicle whose arm moves as recorded, in the simulator's equations."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from angler_experiments.validate_hinsdale.vehicle import WATER, CampaignVehicle
from angler_kernels import quaternion
from angler_mjx.robot.vehicles.link_motion import JointMotion
from angler_mjx.sim.physics.prescribed import accelerate_base

_STAGE_TIMES = (0, 1, 1, 2)
"""Half steps behind the begin of a step at which the four derivatives are taken."""
_STAGE_ADVANCES = (0.0, 0.5, 0.5, 1.0)
"""Steps by which the last derivative moves the state before the next is taken."""
_STAGE_WEIGHTS = (1.0, 2.0, 2.0, 1.0)
"""Weights of the derivatives in a step, by their sum 6."""


class BodyState(NamedTuple):
    """State of the vehicle."""

    p: jax.Array
    """[3] m in the world."""
    q: jax.Array
    """[4] wxyz, vehicle to world."""
    nu: jax.Array
    """[6] velocity in the vehicle's frame."""


class ArmMotion(NamedTuple):
    """Prescribed motion of the arm at one time, or [..., 5] at many."""

    position: jax.Array
    """[5] joint positions in the order of the vehicle file, as recorded; rad, m."""
    velocity: jax.Array
    acceleration: jax.Array


def simulate(
    vehicle: CampaignVehicle, begin: BodyState, joints: ArmMotion, flow: jax.Array, dt: float
) -> BodyState:
    """Return states [n] at the times of the grid, by Runge-Kutta steps of fourth order.

    In steady uniform water and below the surface.

    Args:
        vehicle: parameters.
        begin: at the first time.
        joints: [2 n - 1, 5] at half steps.
        flow: [3] velocity of the water, m/s, in the world.
        dt: step, s.
    """

    def step(state: BodyState, motion: ArmMotion) -> tuple[BodyState, BodyState]:
        after = _step(vehicle, state, motion, flow, dt)
        return after, after

    stages = ArmMotion(*(jnp.stack([x[:-2:2], x[1:-1:2], x[2::2]], axis=1) for x in joints))
    _, states = jax.lax.scan(step, begin, stages)
    return BodyState(*(jnp.concatenate([a[None], b]) for a, b in zip(begin, states, strict=True)))


def _step(
    vehicle: CampaignVehicle, state: BodyState, stages: ArmMotion, flow: jax.Array, dt: float
) -> BodyState:
    """Advance by one step; ``stages`` [3, 5] at its begin, middle and end.

    The four derivatives are a loop: unrolled they take twice as long to compile.
    """

    def stage(
        before: tuple[BodyState, BodyState], inputs: tuple[ArmMotion, jax.Array, jax.Array]
    ) -> tuple[tuple[BodyState, BodyState], None]:
        slope, total = before
        arm, advance, weight = inputs
        point = BodyState(*(x + advance * s for x, s in zip(state, slope, strict=True)))
        slope = _derivative(vehicle, point, arm, flow)
        total = BodyState(*(x + weight * s for x, s in zip(total, slope, strict=True)))
        return (slope, total), None

    zero = BodyState(*(jnp.zeros_like(x) for x in state))
    arms = ArmMotion(*(x[np.array(_STAGE_TIMES)] for x in stages))
    dtype = state.p.dtype
    advances, weights = (jnp.array(x, dtype) for x in (_STAGE_ADVANCES, _STAGE_WEIGHTS))
    _, total = jax.lax.scan(stage, (zero, zero), (arms, dt * advances, weights))[0]
    p, q, nu = (x + dt / 6.0 * s for x, s in zip(state, total, strict=True))
    return BodyState(p, q * jax.lax.rsqrt(jnp.sum(q * q)), nu)


def _derivative(
    vehicle: CampaignVehicle, state: BodyState, arm: ArmMotion, flow: jax.Array
) -> BodyState:
    """Return the derivative of a state by time; heights do not matter below the surface."""
    turn = jnp.concatenate([jnp.zeros(1, state.nu.dtype), state.nu[3:]])
    return BodyState(
        quaternion.rotate(state.q, state.nu[:3]),
        0.5 * quaternion.multiply(state.q, turn),
        accelerate_base(
            vehicle.params,
            jnp.array([0.0, 0.0, -10.0], state.nu.dtype),
            state.q,
            state.nu,
            JointMotion(position=arm.position, velocity=arm.velocity),
            arm.acceleration,
            v_c=flow,
            water=WATER,
        ),
    )
