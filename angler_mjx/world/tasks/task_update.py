"""Update of the task of a world: finished jobs, beliefs, and each robot's next target.

In truth a job is done when a robot was there; robots decide by their beliefs. With perfect
communication all robots decide alike; else each decides by its own information only.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp

from angler_kernels import bit_grid
from angler_kernels.quaternion import rotate
from angler_mjx.world.tasks import allocation, bits, deliver, task_belief, visibility
from angler_mjx.world.tasks.allocation import AllocationView
from angler_mjx.world.tasks.spec import (
    GoodsBelief,
    SurveySpec,
    SurveyWorld,
    TaskSpec,
    TaskState,
    TaskWorld,
)
from angler_mjx.world.tasks.task_belief import TaskScene
from angler_mjx.world.tasks.travel import Travel


def begin_task(
    spec: TaskSpec, task: TaskWorld, start_m: jax.Array, *, heard: bool = False
) -> TaskState:
    """Return the initial state: no job done, no robot sent anywhere.

    Args:
        spec: settings.
        task: task of the world.
        start_m: [R, 3] starts of the robots, in W.
        heard: whether robots know of each other only by received reports.
    """
    jobs, robots, kind = spec.jobs, spec.robots, start_m.dtype
    nothing = jnp.zeros((robots, spec.words), jnp.uint32)
    goods_belief = GoodsBelief(missing=nothing, at_s=jnp.zeros(robots, kind), in_hand=nothing)
    return TaskState(
        done=jnp.zeros(jobs, bool),
        lost=jnp.zeros(jobs, bool),
        by=jnp.full(jobs, -1, jnp.int32),
        done_at_s=jnp.full(jobs, jnp.nan, kind),
        believed_over=nothing,
        target=jnp.full(robots, -1, jnp.int32),
        goal_m=start_m,
        carrying=jnp.full(robots, -1, jnp.int32),
        did=jnp.zeros(robots, jnp.int32),
        finished=jnp.zeros(robots, bool),
        complete=jnp.zeros((), bool),
        completed_s=jnp.full((), jnp.nan, kind),
        progress=jnp.zeros((), kind),
        seen=None if task.survey is None else jnp.zeros_like(task.survey.words),
        seen_at_s=jnp.full(task.survey.cells.shape, jnp.nan, kind)
        if task.survey is not None and spec.timed
        else None,
        goods_belief=goods_belief if heard and spec.goods_return else None,
    )


def update_task(
    spec: TaskSpec, task: TaskWorld, state: TaskState, scene: TaskScene, travel: Travel
) -> TaskState:
    """Return the state after an update.

    Args:
        spec: settings.
        task: task of the world.
        state: state before.
        scene: inputs of the update.
        travel: paths between its places.
    """
    after = task_belief.update_beliefs(spec, task, _update_done(spec, task, state, scene), scene)
    return _choose_targets(
        spec, task, after, scene, travel, task_belief.has_news(spec, state, after, scene)
    )


def _update_done(spec: TaskSpec, task: TaskWorld, state: TaskState, scene: TaskScene) -> TaskState:
    """Update the true state of the jobs since the last update."""
    near = task_belief.find_near(spec, scene.p, task.position_m) & scene.running[:, None]
    by = near[:, : spec.jobs]
    if spec.kind == "deliver":
        state, by = deliver.advance_goods(spec, state, scene.running, near)
    if not spec.shared:
        return _update_visits(spec, task, state, scene, by)
    seen, survey, world = state.seen, spec.survey, task.survey
    if seen is not None and survey is not None and world is not None:
        before, seen = seen, _update_seen(survey, world, seen, scene)
        state = _with_seen(state, seen & ~before, seen, scene.t)
        by = _find_finished(spec, survey, task, world, seen, scene, by)
    new = jnp.any(by, axis=0) & task.exists & ~state.done
    robot = jnp.argmax(by, axis=0).astype(jnp.int32)
    state = _with_done(state, new, robot, scene.t)
    robot_jobs = state.done & (state.by == jnp.arange(spec.robots)[:, None])
    state = replace(state, did=jnp.sum(robot_jobs, axis=1, dtype=jnp.int32))
    progress = jnp.sum(state.done) / jnp.maximum(jnp.sum(task.exists), 1)
    complete = jnp.all(state.done | ~task.exists)
    if seen is not None and survey is not None and world is not None:
        count, total = bit_grid.count_cells(seen), jnp.maximum(world.count, 1)
        progress, complete = count / total, count >= survey.required_cells(total)
    return _with_progress(state, progress, complete, scene.t)


def _with_done(state: TaskState, new: jax.Array, robot: jax.Array, t: jax.Array) -> TaskState:
    return replace(
        state,
        done=state.done | new,
        by=jnp.where(new, robot, state.by),
        done_at_s=jnp.where(new, t, state.done_at_s),
    )


def _with_progress(
    state: TaskState, progress: jax.Array, complete: jax.Array, t: jax.Array
) -> TaskState:
    new = complete & ~state.complete
    return replace(
        state,
        progress=progress.astype(state.progress.dtype),
        complete=state.complete | complete,
        completed_s=jnp.where(new, t, state.completed_s),
    )


def _update_visits(
    spec: TaskSpec, task: TaskWorld, state: TaskState, scene: TaskScene, near: jax.Array
) -> TaskState:
    """Update a tour of which every robot visits all places: each robot knows its own visits."""
    before = bits.unpack_flags(state.believed_over, spec.jobs)
    if spec.ordered:
        jobs = jnp.arange(spec.jobs)
        near &= jobs == jnp.argmin(before, axis=1)[:, None]
    visited = before | near
    everybody = jnp.all(visited, axis=0)
    new = everybody & ~state.done
    last = jnp.argmax(near & ~before, axis=0).astype(jnp.int32)
    count = jnp.sum(visited, axis=1, dtype=jnp.int32)
    state = replace(state, believed_over=bits.pack_flags(visited), did=count)
    state = _with_done(state, new, last, scene.t)
    return _with_progress(state, jnp.mean(visited), jnp.all(everybody), scene.t)


def _update_seen(
    survey: SurveySpec, world: SurveyWorld, seen: jax.Array, scene: TaskScene
) -> jax.Array:
    """Return the cells that any robot has seen so far, uint32 [nx, ny, w]."""
    shape, wanted = scene.grid.occupied.shape, world.words & ~seen
    down = -jax.vmap(rotate, (0, None))(scene.q, jnp.array([0.0, 0.0, 1.0], scene.p.dtype))

    def see_cells(p: jax.Array, down: jax.Array) -> tuple[jax.Array, jax.Array]:
        return visibility.seen_cells(survey, scene.grid, wanted, world.ground, p, down)

    cells, sees = jax.vmap(see_cells)(scene.p, down)
    packed = visibility.pack_columns(survey, shape[2], cells[..., 2], sees & scene.running[:, None])
    return seen | visibility.union_windows(
        survey, shape, visibility.cell_of(scene.grid, scene.p), packed
    )


def _with_seen(state: TaskState, new: jax.Array, seen: jax.Array, t: jax.Array) -> TaskState:
    """Return the state with seen cells uint32 [nx, ny, w], and the new ones of them."""
    at_s = state.seen_at_s
    if at_s is not None:
        at_s = jnp.where(bit_grid.unpack_grid(new, at_s.shape[2]), t, at_s)
    return replace(state, seen=seen, seen_at_s=at_s)


def _find_finished(
    spec: TaskSpec,
    survey: SurveySpec,
    task: TaskWorld,
    world: SurveyWorld,
    seen: jax.Array,
    scene: TaskScene,
    near: jax.Array,
) -> jax.Array:
    """Return the jobs of a survey that are over by each robot, bool [R, M].

    A job is over when all its cells are seen, by any robots, or when a robot has been at its
    viewpoint (``near``, bool [R, M]): more cannot be seen from there. Cells seen in passing are
    attributed to the nearest robot.
    """
    # A whole column is one word or a few: access to each cell would cost several times as much.
    points, shape = task.position_m[: spec.jobs], scene.grid.occupied.shape

    def whole(point: jax.Array, job_cells: jax.Array) -> jax.Array:
        at = visibility.window_columns(survey, shape, visibility.cell_of(scene.grid, point))
        return jnp.all(job_cells & ~seen[at[:, 0], at[:, 1]] == 0)

    apart = jnp.sum((scene.p[:, None] - points) ** 2, axis=-1)
    apart = jnp.where(scene.running[:, None], apart, jnp.inf)
    nearest = jnp.argmin(apart, axis=0) == jnp.arange(spec.robots)[:, None]
    return near | (jax.vmap(whole)(points, world.of_job) & nearest)


def _choose_targets(
    spec: TaskSpec,
    task: TaskWorld,
    state: TaskState,
    scene: TaskScene,
    travel: Travel,
    news: jax.Array,
) -> TaskState:
    """Choose each robot's next target: its current target, unless it has news."""
    over = bits.unpack_flags(state.believed_over, spec.jobs)
    robots = jnp.arange(spec.robots)
    carries = state.carrying >= 0
    before = jnp.where(state.target < spec.jobs, state.target, -1)
    closed = bits.unpack_flags(task_belief.closed_jobs(state), spec.jobs)
    job = jnp.where(news, _allocate_jobs(spec, task, state, scene, travel, closed, news), before)
    target = jnp.where(carries, spec.jobs + state.carrying, job)
    left = ~jnp.all(over, axis=1) | carries
    home = spec.homes + robots
    if spec.after == "return":
        target = jnp.where(target < 0, home, target)
        apart = jnp.sum((scene.p - task.position_m[spec.homes :]) ** 2, axis=-1)
        finished = ~left & (apart <= spec.tolerance_m**2)
    else:
        finished = ~left
    target = jnp.where(scene.running, target, -1).astype(jnp.int32)
    stays, stayed = target < 0, state.target < 0
    stay_m = jnp.where((stays & ~stayed)[:, None], scene.believed_m, state.goal_m)
    return replace(
        state,
        target=target,
        goal_m=jnp.where(stays[:, None], stay_m, task.position_m[jnp.maximum(target, 0)]),
        finished=state.finished | finished,
    )


def _allocate_jobs(
    spec: TaskSpec,
    task: TaskWorld,
    state: TaskState,
    scene: TaskScene,
    travel: Travel,
    closed: jax.Array,
    news: jax.Array,
) -> jax.Array:
    """Return the next job of each robot with news, int32 [R]; -1 for none.

    All other robots count as unable, which keeps the computation small.
    """
    jobs = jnp.arange(spec.jobs, dtype=jnp.int32)
    length = jnp.zeros(spec.jobs, scene.p.dtype)
    if spec.kind == "deliver":
        length = jax.vmap(
            lambda j: travel.path_lengths_m(task.position_m[j][None], spec.jobs + j[None])[0, 0]
        )(jobs)

    def between(job: jax.Array) -> jax.Array:
        end = task.position_m[job + (spec.jobs if spec.kind == "deliver" else 0)]
        return travel.path_lengths_m(end[None], jobs)[0]

    allocate = allocation.in_order if spec.ordered else allocation.named_in_errors(spec.allocation)

    def view(
        p: jax.Array, active: jax.Array, able: jax.Array, open_: jax.Array, part: jax.Array
    ) -> AllocationView:
        return AllocationView(
            open=open_,
            able=able & active,
            active=active,
            p=p,
            travel=travel,
            length_m=length,
            between_m=between,
            rank=task.rank,
            part=part,
            exists=task.exists,
        )

    able = scene.running & (state.carrying < 0) & news
    if not spec.shared:

        def alone(p: jax.Array, able: jax.Array, closed: jax.Array) -> jax.Array:
            part = jnp.zeros(1, jnp.int32)
            return allocate(view(p[None], able[None], able[None], ~closed, part))[0]

        return jax.vmap(alone)(scene.believed_m, able, closed)
    carried = deliver.carried_goods(spec, state)
    if scene.others is None:
        open_ = ~closed[0] & ~carried
        return allocate(view(scene.believed_m, scene.running, able, open_, task.part))

    def of_one(
        robot: jax.Array, p: jax.Array, active: jax.Array, free: jax.Array, closed: jax.Array
    ) -> jax.Array:
        return allocate(view(p, active, free & news[robot], ~closed, task.part))[robot]

    # A robot's information on itself needs no packet.
    robots, others = jnp.arange(spec.robots), scene.others
    p = others.p.at[robots, robots].set(scene.believed_m)
    active = others.active.at[robots, robots].set(scene.running)
    free = (others.active & (others.report.carrying < 0)).at[robots, robots].set(able)
    return jax.vmap(of_one)(robots, p, active, free, closed)
