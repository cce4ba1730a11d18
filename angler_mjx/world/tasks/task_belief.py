"""What robots know of a task: what they see and hear, what they take to be over, and what is new.

Whoever knows everything at once knows what all others do; the rest know what they did, saw and
heard.
"""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp

from angler_mjx.world.grid import Grid
from angler_mjx.world.tasks import bits, deliver
from angler_mjx.world.tasks.spec import GoodsBelief, TaskReport, TaskSpec, TaskState, TaskWorld


@dataclass(frozen=True, kw_only=True)
class TaskScene:
    """What a look sees of one world."""

    t: jax.Array
    """[] s."""
    p: jax.Array
    """[R, 3] where robots are, m in W."""
    q: jax.Array
    """[R, 4] their attitudes, wxyz, body to W."""
    running: jax.Array
    """bool [R] robots whose episode goes on."""
    believed_m: jax.Array
    """[R, 3] where they take themselves to be."""
    grid: Grid
    others: "HeardReports | None" = None
    """What they have heard of each other; None: all know all."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class HeardReports:
    """What each robot knows of the others; the knowing one leads."""

    p: jax.Array
    """[R, R, 3] where they last said they were, m in W."""
    active: jax.Array
    """bool [R, R] who is taken to be at work."""
    said: TaskReport
    """What they last said, [R, R] leading."""
    lost_after_s: float
    """How long one has to be silent to be taken to be lost; so long empty places are believed."""


def report(state: TaskState, running: jax.Array | None = None) -> TaskReport:
    """What robots say; ``running`` is bool [R] whose episode goes on, all if left out."""
    at_work = jnp.ones(state.did.shape, bool) if running is None else running
    return TaskReport(over=state.knows, carrying=state.carrying, at_work=at_work)


def near(spec: TaskSpec, p: jax.Array, place_m: jax.Array) -> jax.Array:
    """Which robots are at which places, bool [R, P]."""
    apart = p[:, None] - place_m
    return jnp.sum(apart * apart, axis=-1) <= spec.tolerance_m**2


def known(spec: TaskSpec, task: TaskWorld, state: TaskState, scene: TaskScene) -> TaskState:
    """Who knows which jobs to be over."""
    if not spec.shared:
        return state
    over = state.done | state.lost | ~task.exists
    if scene.others is None:
        # Nobody works on when enough is seen.
        over |= state.complete
        knows = jnp.broadcast_to(bits.pack(over), state.knows.shape)
        return replace(state, knows=knows)
    # Who comes to a place sees that there is nothing left to do.
    gone = over | deliver.carried(spec, state) if spec.kind == "deliver" else over
    there = near(spec, scene.p, task.place_m[: spec.jobs]) & scene.running[:, None]
    mine = over & (state.by == jnp.arange(spec.robots)[:, None])
    if state.found is not None:  # an empty place does not say that anything is over
        state = replace(state, found=_found(spec, state.found, scene, scene.others, gone, there))
        there = jnp.zeros_like(there)
    own = bits.pack(mine | (gone & there) | ~task.exists)
    heard = bits.together(scene.others.said.over)
    return replace(state, knows=state.knows | own | heard)


def _found(
    spec: TaskSpec,
    found: GoodsBelief,
    scene: TaskScene,
    others: HeardReports,
    gone: jax.Array,
    there: jax.Array,
) -> GoodsBelief:
    """Whose hands which goods are in, as far as each robot knows.

    An empty place says no more than that somebody took what lay there: it is believed for as long
    as it takes to know that one is lost. Who carries goods says so, until they are brought.

    Args:
        spec: settings.
        found: before.
        scene: what is seen.
        others: what is heard.
        gone: bool [M] goods that do not lie where they were.
        there: bool [R, M] who is where goods lie.
    """
    empty = bits.pack(there & gone)
    old = jnp.where((scene.t - found.at_s < others.lost_after_s)[:, None], found.missing, 0)
    missing = (old & ~bits.pack(there & ~gone)) | empty
    new = jnp.any(empty & ~old != 0, axis=1)
    carrying = jnp.where(others.active, others.said.carrying, -1)
    held = jnp.any(carrying[..., None] == jnp.arange(spec.jobs), axis=1)
    return GoodsBelief(
        missing=missing,
        at_s=jnp.where(new, scene.t, found.at_s),
        in_hand=missing | bits.pack(held),
    )


def news(spec: TaskSpec, before: TaskState, after: TaskState, scene: TaskScene) -> jax.Array:
    """Whether a robot has learned anything since the last look, bool [R]: it then thinks anew."""
    learned = jnp.any(closed(before) != closed(after), axis=1) | (scene.t == 0.0)
    if scene.others is None and spec.shared:
        learned |= jnp.any(~scene.running & (before.target >= 0))
    if scene.others is not None:
        # Nobody tells a robot that another has fallen silent, and goods that it put down it may
        # have known to be gone since it took them: who goes to no job looks for one at each look.
        learned |= (before.target < 0) | (before.target >= spec.jobs)
    return learned


def closed(state: TaskState) -> jax.Array:
    """Jobs uint32 [R, W] for which a robot does not set out: over, or in somebody's hands."""
    return state.knows if state.found is None else state.knows | state.found.in_hand
