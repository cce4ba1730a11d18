"""Costs of closed-loop rollouts that can be differentiated with respect to the controllers' gains.

Any engine whose operations have derivatives will do: fused in plain JAX (the fast one), or mjx. A
rollout is differentiated backwards through every control period; of each only the state at its
beginning is kept, everything else is computed again (`jax.checkpoint`), so memory grows by one
state a control period. Decisions (a touch, an arrival, a robot that is held) have no derivative.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp

from angler_mjx.robot.control import plans
from angler_mjx.robot.control.stack import StackGains
from angler_mjx.sim.engines.base import Engine
from angler_mjx.sim.fleet import Fleet
from angler_mjx.sim.state import Outcome, SimSpec, World, WorldState


def tracking_cost(
    gains: StackGains,
    engine: Engine,
    spec: SimSpec,
    fleet: Fleet,
    worlds: World,
    state: WorldState,
    *,
    control_steps: int,
) -> jax.Array:
    """How far robots are from where their paths want them: mean of the squared distance, m^2.

    The mean is over worlds, control steps and the robots that are on their way. The path is taken
    at the time of the simulation, not at the clock of the guidance, which waits for a robot that
    is behind.

    Args:
        gains: of each stage of the controllers, instead of those of ``spec``; differentiate with
            respect to these.
        engine: with derivatives: `FusedEngine` or `MjxEngine`.
        spec: settings of the simulation.
        fleet: compiled vehicles.
        worlds: constants of the worlds, [n] leads.
        state: where they begin.
        control_steps: length of the rollout.

    Returns:
        The cost [].
    """
    spec = replace(spec, gains=gains)

    @jax.checkpoint
    def step_cost(state: WorldState, _: None) -> tuple[WorldState, tuple[jax.Array, jax.Array]]:
        after = engine.control_step(spec, fleet, worlds, state, None)[0]
        # Robots that have not failed move in the whole step, so their positions belong to it.
        is_running = after.tally.outcome == Outcome.RUNNING
        t = after.step[0].astype(after.vehicles.p.dtype) * spec.control_dt_s
        wanted = jax.vmap(jax.vmap(plans.position_at, (0, None)), (0, None))(worlds.path, t)
        square = jnp.sum((after.vehicles.p - wanted) ** 2, axis=-1)
        total = jnp.sum(jnp.where(is_running, square, 0.0))
        return after, (total, jnp.sum(is_running, dtype=total.dtype))

    _, (square, count) = jax.lax.scan(step_cost, state, length=control_steps)
    return jnp.sum(square) / jnp.maximum(jnp.sum(count), 1.0)
