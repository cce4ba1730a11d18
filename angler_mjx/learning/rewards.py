"""Reward of a control step for each robot: weighted sum of terms with names and units."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import isfinite

import jax
import jax.numpy as jnp

from angler_kernels import quaternion
from angler_mjx.errors import ConfigError
from angler_mjx.sim.state import Outcome, WorldState

MARGIN_M = 0.5
"""Distance [m] below which clearance counts as low."""


@dataclass(frozen=True, kw_only=True)
class RewardStep:
    """Step of worlds [W], of one control step or of several."""

    before: WorldState
    after: WorldState
    aim_m: jax.Array
    """[W, R, 3] position of the aim in W."""
    aim_yaw_rad: jax.Array
    """[W, R] heading of the aim."""
    last_action: jax.Array
    """[W, R, size] action of the step before."""
    action: jax.Array
    """[W, R, size] action of this step."""
    dt_s: float


def _distance_to_aim(state: WorldState, aim_m: jax.Array) -> jax.Array:
    return jnp.sqrt(jnp.sum((state.vehicles.p - aim_m) ** 2, axis=-1))


def progress(step: RewardStep) -> jax.Array:
    """Return the decrease of the distance to the aim, m."""
    return _distance_to_aim(step.before, step.aim_m) - _distance_to_aim(step.after, step.aim_m)


def distance(step: RewardStep) -> jax.Array:
    """Return the distance to the aim after the step, times its length, m s."""
    return _distance_to_aim(step.after, step.aim_m) * step.dt_s


def square(step: RewardStep) -> jax.Array:
    """Return the squared distance, times the step's length, m^2 s."""
    return _distance_to_aim(step.after, step.aim_m) ** 2 * step.dt_s


def heading(step: RewardStep) -> jax.Array:
    """Return 1 - cosine of the heading's error, times the step's length, s."""
    yaw = jax.vmap(jax.vmap(quaternion.yaw))(step.after.vehicles.q)
    return (1.0 - jnp.cos(yaw - step.aim_yaw_rad)) * step.dt_s


def energy(step: RewardStep) -> jax.Array:
    """Return the energy of the thrusters, kJ."""
    return (step.after.tally.energy_j - step.before.tally.energy_j) / 1000.0


def clearance(step: RewardStep) -> jax.Array:
    """Return the fall of the least clearance so far in this step, below `MARGIN_M`, m."""

    def margin_shortfall(state: WorldState) -> jax.Array:
        min_distance_m = jnp.minimum(state.tally.min_clearance_m, state.tally.min_separation_m)
        return jnp.clip(MARGIN_M - min_distance_m, 0.0, MARGIN_M)

    return margin_shortfall(step.after) - margin_shortfall(step.before)


def collision(step: RewardStep) -> jax.Array:
    """Return 1 in the step of the robot's failure: contact, leaving the region, divergence."""
    outcome = step.after.tally.outcome
    ended = (step.before.tally.outcome == Outcome.RUNNING) & (outcome != Outcome.RUNNING)
    return (ended & (outcome != Outcome.REACHED)).astype(step.action.dtype)


def arrival(step: RewardStep) -> jax.Array:
    """Return 1 in the step in which the robot reaches its goal."""
    running = step.before.tally.outcome == Outcome.RUNNING
    return (running & (step.after.tally.outcome == Outcome.REACHED)).astype(step.action.dtype)


def roughness(step: RewardStep) -> jax.Array:
    """Return the mean square of the change of the action's numbers since the step before."""
    if not step.action.shape[-1]:
        return jnp.zeros(step.action.shape[:-1], step.action.dtype)
    return jnp.mean((step.action - step.last_action) ** 2, axis=-1)


TERMS: dict[str, Callable[[RewardStep], jax.Array]] = {
    term.__name__: term
    for term in (
        progress, distance, square, heading, energy, clearance, collision, arrival, roughness
    )
}  # fmt: skip
"""Terms by name; each gives [W, R], 0 for robots whose episode had ended."""

DEFAULT_WEIGHTS = {
    "progress": 1.0,
    "energy": -0.1,
    "clearance": -1.0,
    "collision": -10.0,
    "arrival": 10.0,
}


def check_weights(weights: Mapping[str, float]) -> tuple[tuple[str, float], ...]:
    """Return weights of terms as a tuple.

    Raises:
        ConfigError: a term does not exist, there is no term, or a weight is not finite.
    """
    unknown = [name for name in weights if name not in TERMS]
    if unknown or not weights:
        raise ConfigError(
            f"reward = {dict(weights)}: give weights to some of {', '.join(TERMS)}"
            + (f"; there is no {unknown[0]!r}" if unknown else "")
        )
    for name, weight in weights.items():
        is_number = isinstance(weight, int | float) and not isinstance(weight, bool)
        if not is_number or not isfinite(weight):
            raise ConfigError(f"reward.{name} = {weight!r}: give a finite number")
    return tuple((name, float(weight)) for name, weight in weights.items())


def compute_reward(
    weights: tuple[tuple[str, float], ...], step: RewardStep
) -> tuple[jax.Array, dict[str, jax.Array]]:
    """Return the reward [W, R], and its weighted terms by name, whose sum it is."""
    is_running = step.before.tally.outcome == Outcome.RUNNING
    terms = {
        name: jnp.where(is_running, weight * TERMS[name](step), 0.0) for name, weight in weights
    }
    total = jnp.sum(jnp.stack(list(terms.values())), axis=0)
    return total, terms
