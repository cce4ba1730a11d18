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
    report: TaskReport
    """What they last said, [R, R] leading."""
    lost_after_s: float
    """How long one has to be silent to be taken to be lost; so long empty places are believed."""


def build_report(state: TaskState, running: jax.Array | None = None) -> TaskReport:
    """What robots say; ``running`` is bool [R] whose episode goes on, all if left out."""
    at_work = jnp.ones(state.did.shape, bool) if running is None else running
    return TaskReport(over=state.believed_over, carrying=state.carrying, at_work=at_work)


def find_near(spec: TaskSpec, p: jax.Array, position_m: jax.Array) -> jax.Array:
    """Which robots are at which places, bool [R, P]."""
    apart = p[:, None] - position_m
    return jnp.sum(apart * apart, axis=-1) <= spec.tolerance_m**2


def update_beliefs(
    spec: TaskSpec, task: TaskWorld, state: TaskState, scene: TaskScene
) -> TaskState:
    """Who knows which jobs to be over."""
    if not spec.shared:
        return state
    over = state.done | state.lost | ~task.exists
    if scene.others is None:
        # Nobody works on when enough is seen.
        over |= state.complete
        believed_over = jnp.broadcast_to(bits.pack_flags(over), state.believed_over.shape)
        return replace(state, believed_over=believed_over)
    # Who comes to a place sees that there is nothing left to do.
    gone = over | deliver.carried_goods(spec, state) if spec.kind == "deliver" else over
    at_position = find_near(spec, scene.p, task.position_m[: spec.jobs]) & scene.running[:, None]
    done_jobs = over & (state.by == jnp.arange(spec.robots)[:, None])
    if state.goods_belief is not None:  # an empty place does not say that anything is over
        state = replace(
            state,
            goods_belief=_update_goods_belief(
                spec, state.goods_belief, scene, scene.others, gone, at_position
            ),
        )
        at_position = jnp.zeros_like(at_position)
    observed = bits.pack_flags(done_jobs | (gone & at_position) | ~task.exists)
    heard = bits.union_words(scene.others.report.over)
    return replace(state, believed_over=state.believed_over | observed | heard)


def _update_goods_belief(
    spec: TaskSpec,
    belief: GoodsBelief,
    scene: TaskScene,
    others: HeardReports,
    gone: jax.Array,
    at_position: jax.Array,
) -> GoodsBelief:
    """Whose hands which goods are in, as far as each robot knows.

    An empty place says no more than that somebody took what lay there: it is believed for as long
    as it takes to know that one is lost. Who carries goods says so, until they are brought.

    Args:
        spec: settings.
        belief: before.
        scene: what is seen.
        others: what is heard.
        gone: bool [M] goods that do not lie where they were.
        at_position: bool [R, M] who is where goods lie.
    """
    empty = bits.pack_flags(at_position & gone)
    old = jnp.where((scene.t - belief.at_s < others.lost_after_s)[:, None], belief.missing, 0)
    missing = (old & ~bits.pack_flags(at_position & ~gone)) | empty
    new = jnp.any(empty & ~old != 0, axis=1)
    carrying = jnp.where(others.active, others.report.carrying, -1)
    held = jnp.any(carrying[..., None] == jnp.arange(spec.jobs), axis=1)
    return GoodsBelief(
        missing=missing,
        at_s=jnp.where(new, scene.t, belief.at_s),
        in_hand=missing | bits.pack_flags(held),
    )


def has_news(spec: TaskSpec, before: TaskState, after: TaskState, scene: TaskScene) -> jax.Array:
    """Whether a robot has learned anything since the last look, bool [R]: it then thinks anew."""
    learned = jnp.any(closed_jobs(before) != closed_jobs(after), axis=1) | (scene.t == 0.0)
    if scene.others is None and spec.shared:
        learned |= jnp.any(~scene.running & (before.target >= 0))
    if scene.others is not None:
        # Nobody tells a robot that another has fallen silent, and goods that it put down it may
        # have known to be gone since it took them: who goes to no job looks for one at each look.
        learned |= (before.target < 0) | (before.target >= spec.jobs)
    return learned


def closed_jobs(state: TaskState) -> jax.Array:
    """Jobs uint32 [R, W] for which a robot does not set out: over, or in somebody's hands."""
    return (
        state.believed_over
        if state.goods_belief is None
        else state.believed_over | state.goods_belief.in_hand
    )
