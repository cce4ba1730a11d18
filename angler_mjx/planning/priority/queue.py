"""Queue of teams planned side by side: the next team takes the slot of a finished one.

Worlds need very different effort: most teams are planned in the first pass, a few only after the
whole budget. In lock-step all would wait for the hardest. Instead a fixed number of slots hold a
world each; a slot whose team is finished stores its paths and takes the next world. The result of a
team depends on that team alone, not on the slots or the others in the batch.
"""

from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class _Slots[State, Out]:
    state: State
    world: jax.Array
    """int32 [S] which world each slot holds; past the last: none."""
    taken: jax.Array
    """int32 [] worlds that were taken so far."""
    out: Out


def run_slots[Task, State, Out](
    tasks: Task,
    count: int,
    slots: int,
    *,
    begin: Callable[[Task], State],
    step: Callable[[Task, State], State],
    ended: Callable[[State], jax.Array],
    result: Callable[[State], Out],
) -> Out:
    """Step every task until it has ended.

    Args:
        tasks: [count] leads on every leaf.
        count: of them.
        slots: how many are stepped side by side, at most.
        begin: state of one task.
        step: a step of one task.
        ended: bool [] whether a search has ended; called after at least one step.
        result: result of a search.

    Returns:
        [count] leading.
    """
    slots = min(slots, count)

    def tasks_of(world: jax.Array) -> Task:
        at = jnp.minimum(world, count - 1)
        some: Task = jax.tree.map(lambda leaf: leaf[at], tasks)
        return some

    def is_running(now: _Slots[State, Out]) -> jax.Array:
        return jnp.any(now.world < count)

    def step_slots(now: _Slots[State, Out]) -> _Slots[State, Out]:
        slot_tasks = tasks_of(now.world)
        state = jax.vmap(step)(slot_tasks, now.state)
        is_done = jax.vmap(ended)(state) & (now.world < count)
        results = jax.vmap(result)(state)
        out_index = jnp.where(is_done, now.world, count)
        out = jax.tree.map(
            lambda all_, some: all_.at[out_index].set(some, mode="drop"), now.out, results
        )
        world = jnp.where(is_done, now.taken + jnp.cumsum(is_done) - 1, now.world)
        new_state = jax.vmap(begin)(tasks_of(world))

        def choose(a: jax.Array, b: jax.Array) -> jax.Array:
            return jnp.where(is_done.reshape((-1,) + (1,) * (a.ndim - 1)), a, b)

        return _Slots(
            state=jax.tree.map(choose, new_state, state),
            world=world.astype(jnp.int32),
            taken=now.taken + jnp.sum(is_done, dtype=jnp.int32),
            out=out,
        )

    world = jnp.arange(slots, dtype=jnp.int32)
    state = jax.vmap(begin)(tasks_of(world))
    result_shape = jax.eval_shape(lambda: jax.vmap(result)(state))
    out = jax.tree.map(lambda leaf: jnp.zeros((count, *leaf.shape[1:]), leaf.dtype), result_shape)
    start = _Slots(state=state, world=world, taken=jnp.int32(slots), out=out)
    end: _Slots[State, Out] = jax.lax.while_loop(is_running, step_slots, start)
    return end.out
