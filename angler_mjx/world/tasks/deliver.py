"""Delivery of goods: each robot carries one item at a time."""

from dataclasses import replace

import jax
import jax.numpy as jnp

from angler_mjx.world.tasks.spec import TaskSpec, TaskState


def carried_goods(spec: TaskSpec, state: TaskState) -> jax.Array:
    """Return the goods carried by a robot, bool [M]."""
    holds = state.carrying[:, None] == jnp.arange(spec.jobs)
    return jnp.any(holds, axis=0)


def advance_goods(
    spec: TaskSpec, state: TaskState, running: jax.Array, near: jax.Array
) -> tuple[TaskState, jax.Array]:
    """Deliver goods at their destinations, and pick up goods where robots were sent for them.

    Args:
        spec: settings.
        state: state before.
        running: bool [R] robots whose episode continues.
        near: bool [R, P] running robots at places.

    Returns:
        The state, and bool [R, M] goods delivered by each robot.
    """
    jobs, robots = spec.jobs, jnp.arange(spec.robots)
    holds = state.carrying[:, None] == jnp.arange(jobs)
    dropped = jnp.any(holds & ~running[:, None], axis=0)
    brought = holds & near[:, jobs : 2 * jobs]
    keeps = running & ~jnp.any(brought, axis=1)
    carrying = jnp.where(keeps, state.carrying, -1)
    lost = state.lost | dropped if spec.dropped == "lost" else state.lost
    # One robot takes it, though two with little information on each other may come for it.
    at_pickup = near[:, :jobs] & (state.target[:, None] == jnp.arange(jobs))
    at_pickup &= (carrying < 0)[:, None] & ~(
        state.done | lost | jnp.any(holds & running[:, None], axis=0)
    )
    takes = at_pickup & (jnp.argmax(at_pickup, axis=0) == robots[:, None])
    carrying = jnp.where(jnp.any(takes, axis=1), jnp.argmax(takes, axis=1), carrying)
    return replace(state, carrying=carrying.astype(jnp.int32), lost=lost), brought
