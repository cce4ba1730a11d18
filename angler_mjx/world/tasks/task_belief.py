"""Beliefs of robots on a task: sight, reports, finished jobs, and news.

With perfect communication every robot has all information; else each has its own actions, sight and
received reports.
"""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp

from angler_mjx.world.rock.grid import Grid
from angler_mjx.world.tasks import bits, deliver
from angler_mjx.world.tasks.spec import GoodsBelief, TaskReport, TaskSpec, TaskState, TaskWorld


@dataclass(frozen=True, kw_only=True)
class TaskScene:
    """Inputs of a task update of one world."""

    t: jax.Array
    """[] s."""
    p: jax.Array
    """[R, 3] positions of robots, m in W."""
    q: jax.Array
    """[R, 4] their attitudes, wxyz, body to W."""
    running: jax.Array
    """bool [R] robots whose episode continues."""
    believed_m: jax.Array
    """[R, 3] the robots' estimates of their positions."""
    grid: Grid
    others: "HeardReports | None" = None
    """Reports that they have received; None: all robots have all information."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class HeardReports:
    """Information of each robot on the others; the receiver leads."""

    p: jax.Array
    """[R, R, 3] last reported positions, m in W."""
    active: jax.Array
    """bool [R, R] robots believed to be active."""
    report: TaskReport
    """Last reports, [R, R] leading."""
    lost_after_s: float
    """Silence after which a robot is believed lost; beliefs in empty places last as long."""


def build_report(state: TaskState, running: jax.Array | None = None) -> TaskReport:
    """Build the robots' reports; ``running`` is bool [R] continuing episodes, all if left out."""
    at_work = jnp.ones(state.did.shape, bool) if running is None else running
    return TaskReport(over=state.believed_over, carrying=state.carrying, at_work=at_work)


def find_near(spec: TaskSpec, p: jax.Array, position_m: jax.Array) -> jax.Array:
    """Return whether each robot is at each place, bool [R, P]."""
    apart = p[:, None] - position_m
    return jnp.sum(apart * apart, axis=-1) <= spec.tolerance_m**2


def update_beliefs(
    spec: TaskSpec, task: TaskWorld, state: TaskState, scene: TaskScene
) -> TaskState:
    """Update the jobs that each robot believes to be over."""
    if not spec.shared:
        return state
    over = state.done | state.lost | ~task.exists
    if scene.others is None:
        # Work ends when enough is seen.
        over |= state.complete
        believed_over = jnp.broadcast_to(bits.pack_flags(over), state.believed_over.shape)
        return replace(state, believed_over=believed_over)
    # A robot at a place sees that there is nothing left to do.
    gone = over | deliver.carried_goods(spec, state) if spec.kind == "deliver" else over
    at_position = find_near(spec, scene.p, task.position_m[: spec.jobs]) & scene.running[:, None]
    done_jobs = over & (state.by == jnp.arange(spec.robots)[:, None])
    if state.goods_belief is not None:  # an empty place does not show that a job is over
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
    """Update the goods that each robot believes to be carried.

    An empty place shows only that a robot took the goods there: the belief lasts for the time after
    which a silent robot is considered lost. A robot reports the goods it carries until they are
    delivered.

    Args:
        spec: settings.
        belief: belief before.
        scene: inputs of the update.
        others: received reports.
        gone: bool [M] goods that are not at their pickup place.
        at_position: bool [R, M] robots at the pickup places of goods.
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
    """Return whether a robot has news since the last update, bool [R]: it then decides again."""
    learned = jnp.any(closed_jobs(before) != closed_jobs(after), axis=1) | (scene.t == 0.0)
    if scene.others is None and spec.shared:
        learned |= jnp.any(~scene.running & (before.target >= 0))
    if scene.others is not None:
        # No report says that another robot has fallen silent, and a robot may have known goods
        # that it put down to be gone since it took them: robots without a job look for one at
        # each update.
        learned |= (before.target < 0) | (before.target >= spec.jobs)
    return learned


def closed_jobs(state: TaskState) -> jax.Array:
    """Return jobs uint32 [R, W] that a robot does not begin: over, or carried by others."""
    return (
        state.believed_over
        if state.goods_belief is None
        else state.believed_over | state.goods_belief.in_hand
    )
