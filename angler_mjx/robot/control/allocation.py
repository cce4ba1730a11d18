"""From a wrench to thruster signals, with a saturation that keeps the vehicle upright.

What cannot be delivered is given up in this order: surge and sway first (both by the same factor,
so the direction stays), then heave, then attitude.

A thruster that gives only a share h of its thrust is counted by what a sound one would give for the
same signal: B diag(h) takes the place of B, so all thrusters keep the limits of the table, weak
ones are asked for less, and dead ones for nothing.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from angler_kernels import thruster
from angler_kernels.rigid_body import matrix_times
from angler_mjx.robot.control.commands import BodyWrench, ThrusterPwm
from angler_mjx.robot.vehicles.fins import HALF_RANGE_US, lift_matrix
from angler_mjx.robot.vehicles.params import VehicleParams
from angler_mjx.robot.vehicles.thrusters import PWM_LOW_US, PWM_STEP_US, FloatArray

NEUTRAL_US = 1500.0
"""The signal of a thruster that stands still."""
MIN_THRUST_N = 0.005
"""Half a unit of the last place of the thrust data: less than this is no thrust. Without it the
rounding of a balanced wrench would switch a thruster between the two edges of its dead band."""
_GROUPS = ((0, 0, 0, 1, 1, 1), (0, 0, 1, 0, 0, 0), (1, 1, 0, 0, 0, 0))
"""Axes in the order of their importance."""
_RELATIVE_RANK = 1e-2
"""Singular values below this share of the largest are the geometry's small offsets."""
FIN_SPEED_MPS = 0.2
"""Speed ahead below which fins are deflected less and less: their force is lost in the noise."""
_STILL_N = 1e-4
"""A demand that changes a thrust by less does not bound the demand: it may be rounding."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class AllocationParams:
    """The thrusters of one vehicle, as the allocation sees them."""

    B_inverse: jax.Array
    """[n_thruster, 6] pseudo-inverse of ``B``, over the axes the thrusters command."""
    thrust_n: jax.Array
    """[n_pwm] thrust table at the battery's voltage; [n_thruster, n_pwm] where thrusters differ."""
    B: jax.Array
    """[6, n_thruster] wrench per newton of a sound thruster, times the known health."""
    mode: jax.Array
    """[n_thruster] thrusts that together make no wrench, 1 N at most; 0 where a thruster has none.
    Thrusters of one number in ``mode_of`` must change together."""
    mode_of: jax.Array
    """[n_thruster] number of the mode that a thruster belongs to."""
    fins: "FinAllocation | None" = None
    """Fins; None where no vehicle of the fleet has any."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class FinAllocation:
    """The fins of one vehicle, as the allocation sees them."""

    inverse: jax.Array
    """[n_thruster, 6] deflection times dynamic pressure per wrench, rad Pa per N m: pseudo-inverse
    over the moments that fins make and thrusters do not."""
    limit_rad: jax.Array
    """[n_thruster] largest deflection; 0 for thrusters."""
    is_fin: jax.Array
    """bool [n_thruster]."""


def build_allocation(vehicles: VehicleParams, health: ArrayLike | None = None) -> AllocationParams:
    """Allocation of each variant; leading axis [n_variant] as in ``vehicles`` (host side).

    An axis that the thrusters command only through the geometry's small offsets (pitch on the
    six-thruster vehicle) is left out: its share diag(B B^+) of a demand is below one half.

    Args:
        vehicles: the variants.
        health: [n_variant, n_thruster] share of its thrust that each thruster gives, as far as the
            allocation knows; that of ``vehicles`` if left out.
    """
    factors = np.asarray(vehicles.thruster_health if health is None else health, np.float64)
    matrices = np.asarray(vehicles.B, np.float64) * factors[:, None, :]
    inverses, modes, owners = [], [], []
    for matrix in matrices:
        commanded = np.diag(matrix @ np.linalg.pinv(matrix, rcond=_RELATIVE_RANK)) > 0.5
        inverse = np.linalg.pinv(matrix * commanded[:, None], rcond=_RELATIVE_RANK)
        inverse[np.abs(inverse) < 1e-7 * np.abs(inverse).max()] = 0.0  # B has 24 bits
        inverses.append(inverse)
        mode, owner = _find_modes(matrix, inverse)
        modes.append(mode)
        owners.append(owner)
    return AllocationParams(
        B_inverse=jnp.asarray(np.stack(inverses), vehicles.B.dtype),
        thrust_n=vehicles.thrust_n,
        B=jnp.asarray(matrices, vehicles.B.dtype),
        mode=jnp.asarray(np.stack(modes), vehicles.B.dtype),
        mode_of=jnp.asarray(np.stack(owners), jnp.int32),
        fins=_build_fins(vehicles, matrices),
    )


def _build_fins(vehicles: VehicleParams, matrices: FloatArray) -> FinAllocation | None:
    """Return the fins of vehicles whose thrusters have ``matrices`` [n_variant, 6, n_thruster]."""
    fins = vehicles.fins
    if fins is None:
        return None
    inverses = []
    for turning, matrix in zip(lift_matrix(fins), matrices, strict=True):
        commanded = np.diag(matrix @ np.linalg.pinv(matrix, rcond=_RELATIVE_RANK)) > 0.5
        rows = turning * (~commanded & (np.arange(6) >= 3))[:, None]
        if not np.any(rows):
            inverses.append(np.zeros_like(turning.T))
            continue
        reached = np.diag(rows @ np.linalg.pinv(rows, rcond=_RELATIVE_RANK)) > 0.5
        inverses.append(np.linalg.pinv(rows * reached[:, None], rcond=_RELATIVE_RANK))
    return FinAllocation(
        inverse=jnp.asarray(np.stack(inverses), vehicles.B.dtype),
        limit_rad=fins.limit_rad,
        is_fin=fins.is_fin,
    )


def _find_modes(matrix: FloatArray, inverse: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Redundancies of the thrusters, each of other thrusters than the rest: [n] and [n].

    I - B^+ B projects on the thrusts without a wrench; thrusters that it joins make one block. A
    block with several redundancies (no shipped vehicle has one) is given one of them.
    """
    n = matrix.shape[1]
    exists = np.any(matrix != 0.0, axis=0)
    free = (np.eye(n) - inverse @ matrix) * np.outer(exists, exists)
    joined = np.abs(free) > 1e-5  # B has 24 bits
    for _ in range(n):
        joined = joined @ joined
    mode, owner = np.zeros(n), np.arange(n, dtype=np.float64)
    for first in np.flatnonzero(np.diag(joined)):
        block = np.flatnonzero(joined[first])
        if block[0] == first:
            column = free[:, block[np.argmax(np.diag(free)[block])]]
            column = np.where(np.abs(column) > 1e-5, column, 0.0)
            mode[block] = (column / np.abs(column).max())[block]
            owner[block] = first
    return mode, owner


def allocate(params: AllocationParams, command: BodyWrench) -> ThrusterPwm:
    """Thruster signals for a wrench, by the pseudo-inverse.

    Least thrusts; a demand that runs a thruster to its end is cut there, even if others could make
    up for it (`allocate_to_limits` lets them).

    Args:
        params: of one vehicle.
        command: wrench [6] at the centre of mass, in F.

    Returns:
        PWM [n_thruster]; a demand below ``MIN_THRUST_N`` gives the neutral signal.
    """
    low, high = _find_limits(params)
    tau = command.tau
    groups = jnp.array(_GROUPS, tau.dtype)
    thrust = jnp.zeros(params.B_inverse.shape[0], tau.dtype)
    for group in groups:
        extra = matrix_times(params.B_inverse, tau * group)
        thrust = thrust + _largest_fraction(thrust, extra, low, high) * extra
    return _to_pwm(params, thrust)


def allocate_to_limits(params: AllocationParams, command: BodyWrench) -> ThrusterPwm:
    """Thruster signals for a wrench, of which as much is met as the thrusters can.

    As `allocate`, but where a thruster runs to its end the others of its mode make up for it: with
    f = B^+ tau + sum_m z_m n_m, each group is met to the largest share for which some z keeps
    all thrusts within their limits. Modes share no thruster, so that share is a least quotient over
    pairs of thrusters: exact, without iteration.

    Args:
        params: of one vehicle.
        command: wrench [6] at the centre of mass, in F.

    Returns:
        PWM [n_thruster]; the same as `allocate`'s where no thruster runs to its end.
    """
    low, high = _find_limits(params)
    tau = command.tau
    thrust = jnp.zeros(params.B_inverse.shape[0], tau.dtype)
    for group in jnp.array(_GROUPS, tau.dtype):
        extra = matrix_times(params.B_inverse, tau * group)
        fraction = _reachable_fraction(params, thrust, extra, low, high)
        thrust = thrust + fraction * extra
    lower, upper = _mode_range(params, thrust, low, high)
    same = params.mode_of[:, None] == params.mode_of
    lower = jnp.max(jnp.where(same, lower, -jnp.inf), axis=1)
    upper = jnp.min(jnp.where(same, upper, jnp.inf), axis=1)
    thrust = thrust + params.mode * jnp.minimum(jnp.maximum(0.0, lower), upper)
    return _to_pwm(params, jnp.clip(thrust, low, high))


def deflect_fins(
    fins: FinAllocation, command: BodyWrench, speed_mps: jax.Array, density: float, pwm: ThrusterPwm
) -> ThrusterPwm:
    """Return signals in which fins make the moments that a wrench asks of them.

    The moment of a deflection goes with the dynamic pressure q = 1/2 rho u |u| of the flow ahead;
    1 / q is taken as q / (q^2 + q_0^2), with q_0 at `FIN_SPEED_MPS`, so that fins stay near the
    middle where they make no force, and are turned round astern.

    Args:
        fins: of one vehicle.
        command: wrench [6] at the centre of mass, in F.
        speed_mps: [] ahead, as far as the controller knows it.
        density: of the water, kg/m^3.
        pwm: signals of the thrusters.
    """
    pressure = 0.5 * density * speed_mps * jnp.abs(speed_mps)
    still = 0.5 * density * FIN_SPEED_MPS**2
    gain = pressure / (pressure**2 + still**2)
    limit = jnp.where(fins.limit_rad > 0, fins.limit_rad, 1.0)
    travel = jnp.clip(matrix_times(fins.inverse, command.tau) * gain / limit, -1.0, 1.0)
    return ThrusterPwm(
        pwm_us=jnp.where(fins.is_fin, NEUTRAL_US + HALF_RANGE_US * travel, pwm.pwm_us)
    )


def realised_wrench(params: AllocationParams, pwm: ThrusterPwm) -> BodyWrench:
    """Wrench that signals settle at: what becomes of a demand, as far as the allocation knows.

    Args:
        params: of one vehicle.
        pwm: signals [n_thruster].

    Returns:
        Wrench [6] at the centre of mass, in F; also about axes that are not commanded.
    """
    look = jax.vmap(thruster.lookup, (_table_axis(params), 0, None, None))
    thrust = look(params.thrust_n, pwm.pwm_us, PWM_LOW_US, PWM_STEP_US)
    return BodyWrench(tau=matrix_times(params.B, thrust))


def _table_axis(params: AllocationParams) -> int | None:
    """Return the axis of thrusters in ``thrust_n``; None where one table serves all."""
    return 0 if params.thrust_n.ndim > 1 else None


def _find_limits(params: AllocationParams) -> tuple[jax.Array, jax.Array]:
    """Return the least and the greatest thrust [] of all thrusters, or [n] of each."""
    if params.thrust_n.ndim > 1:
        return params.thrust_n[:, 0], params.thrust_n[:, -1]
    return params.thrust_n[0], params.thrust_n[-1]


def _to_pwm(params: AllocationParams, thrust: jax.Array) -> ThrusterPwm:
    pwm = jax.vmap(thruster.inverse_lookup, (_table_axis(params), 0, None, None))(
        params.thrust_n, thrust, PWM_LOW_US, PWM_STEP_US
    )
    return ThrusterPwm(pwm_us=jnp.where(jnp.abs(thrust) < MIN_THRUST_N, NEUTRAL_US, pwm))


def _largest_fraction(
    base: jax.Array, extra: jax.Array, low: jax.Array, high: jax.Array
) -> jax.Array:
    """Largest factor in [0, 1] that keeps ``base + factor * extra`` [n] within [low, high]."""
    moving = jnp.abs(extra) > _STILL_N
    room = jnp.where(extra > 0, high - base, low - base) / jnp.where(moving, extra, 1.0)
    return jnp.clip(jnp.min(jnp.where(moving, room, 1.0)), 0.0, 1.0)


def _reachable_fraction(
    params: AllocationParams, base: jax.Array, extra: jax.Array, low: jax.Array, high: jax.Array
) -> jax.Array:
    """Largest factor in [0, 1] for which some z keeps ``base + factor * extra + z mode`` in limits.

    Thruster i of a mode bounds z from below by l_i - factor d_i and from above by u_i - factor d_i,
    d = extra / mode. There is such a z as long as no lower bound l_i passes an upper one u_j.
    """
    free = params.mode != 0.0
    alone = _largest_fraction(base, jnp.where(free, 0.0, extra), low, high)
    lower, upper = _mode_range(params, base, low, high)
    rate = extra / jnp.where(free, params.mode, 1.0)
    closing = rate[None, :] - rate[:, None]  # of [i, j]: of l_i on u_j
    pair = free[:, None] & (params.mode_of[:, None] == params.mode_of) & (closing > _STILL_N)
    gap = (upper[None, :] - lower[:, None]) / jnp.where(pair, closing, 1.0)
    together = jnp.min(jnp.where(pair, gap, 1.0))
    return jnp.clip(jnp.minimum(alone, together), 0.0, 1.0)


def _mode_range(
    params: AllocationParams, thrust: jax.Array, low: jax.Array, high: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """How far each thruster's mode may go down and up, [n] each; nowhere without a mode."""
    free, up = params.mode != 0.0, params.mode > 0.0
    each = jnp.where(free, params.mode, 1.0)
    lower = jnp.where(free, (jnp.where(up, low, high) - thrust) / each, 0.0)
    upper = jnp.where(free, (jnp.where(up, high, low) - thrust) / each, 0.0)
    return lower, upper
