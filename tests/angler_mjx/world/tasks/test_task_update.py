"""Tasks flown by points that go straight to where they are sent: who does what, and the end."""

import math
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.world.rock.grid import Grid
from angler_mjx.world.tasks import bits, sampling, task_update, visibility
from angler_mjx.world.tasks.sampling import GoalSampling
from angler_mjx.world.tasks.spec import SurveySpec, TaskReport, TaskSpec, TaskState, TaskWorld
from angler_mjx.world.tasks.task_belief import HeardReports, TaskScene
from angler_mjx.world.tasks.travel import Travel

ROBOTS, SHAPE, CELL = 3, (8, 8, 6), 1.5
STEP_M, LOOKS = 0.4, 900
LEVEL = jnp.tile(jnp.array([1.0, 0.0, 0.0, 0.0]), (ROBOTS, 1))


class Water:
    """As much of an environment as a task is drawn in."""

    def __init__(self) -> None:
        origin = jnp.array([-6.0, -6.0, -10.0])
        free = jnp.zeros(SHAPE, bool)
        self.grid = Grid(occupied=free, origin_m=origin, cell_m=jnp.array(CELL))
        self.floor_z_m = jnp.array(-10.0)
        self.start_m = jnp.array([[-5.0, -5.0, -3.0], [-5.0, 0.0, -3.0], [-5.0, 5.0, -3.0]])


def task_of(spec: TaskSpec) -> TaskWorld:
    places = (GoalSampling(within=((0.3, 0.0, 0.0), (1.0, 1.0, 1.0))), GoalSampling())
    environment: Any = Water()
    return sampling.sample_task(
        spec, *places, jax.random.key(4), environment, jnp.ones(SHAPE, bool)
    )


@partial(jax.jit, static_argnums=0)
def looked(
    spec: TaskSpec, task: TaskWorld, state: TaskState, p: Any, running: Any, t: Any, others: Any
) -> TaskState:
    grid = Water().grid
    scene = TaskScene(t=t, p=p, q=LEVEL, running=running, believed_m=p, grid=grid, others=others)
    return task_update.update_task(spec, task, state, scene, Travel(position_m=task.position_m))


def flown(
    spec: TaskSpec, ends: dict[int, int] | None = None
) -> tuple[TaskWorld, list[Any], list[Any]]:
    """States of all looks, and who was under way; robot r ends at look ``ends[r]``."""
    task = task_of(spec)
    p, running = np.asarray(Water().start_m), np.ones(spec.robots, bool)
    state, states, under_way = task_update.begin_task(spec, task, jnp.asarray(p)), [], []
    for look in range(LOOKS):
        for robot, at in (ends or {}).items():
            running[robot] &= look < at
        state = looked(spec, task, state, p, running.copy(), 0.5 * look, None)
        states.append(jax.tree.map(np.asarray, state))
        under_way.append(running.copy())
        running &= ~states[-1].finished
        way = states[-1].goal_m - p
        far = np.linalg.norm(way, axis=1, keepdims=True)
        p = p + np.where(running[:, None], way * np.minimum(1.0, STEP_M / np.maximum(far, 1e-9)), 0)
        if not running.any():
            break
    return task, states, under_way


def heard(active: Any = False, over: Any = 0, carrying: Any = -1) -> HeardReports:
    """What each robot has heard of each, the receiver first; nothing if left out."""
    each = (ROBOTS, ROBOTS)
    return HeardReports(
        p=jnp.zeros((*each, 3)) + Water().start_m,
        active=jnp.broadcast_to(jnp.asarray(active), each),
        report=TaskReport(
            over=jnp.broadcast_to(jnp.asarray(over, jnp.uint32), (*each, 1)),
            carrying=jnp.broadcast_to(jnp.asarray(carrying, jnp.int32), each),
            at_work=jnp.ones(each, bool),
        ),
        lost_after_s=60.0,
    )


def spec_of(kind: str, jobs: int, **more: Any) -> TaskSpec:
    return TaskSpec(
        kind=kind,
        jobs=jobs,
        robots=ROBOTS,
        tolerance_m=0.5,
        period=1,
        **more,  # type: ignore[arg-type]
    )


@pytest.mark.parametrize("allocation", ["nearest", "auction", "sweep"])
def test_every_place_of_a_shared_tour_is_done_once(allocation: str) -> None:
    _, states, _ = flown(spec_of("tour", 9, allocation=allocation))
    done = np.array([state.done for state in states])
    assert [float(state.progress) for state in states] == pytest.approx(done.mean(axis=1))
    assert (np.diff(done.astype(int), axis=0) >= 0).all()
    last = states[-1]
    assert last.done.all()
    assert last.finished.all()
    assert last.did.sum() == 9
    assert (last.did > 0).all()
    assert last.complete
    assert last.completed_s == np.max(last.done_at_s)
    targets = np.array([state.target for state in states])
    for row in targets:
        chosen = row[row >= 0].tolist()
        assert len(set(chosen)) == len(chosen)


def test_a_lost_robots_share_is_taken_over_and_nobody_finishes_before() -> None:
    for allocation in ("nearest", "sweep"):
        spec = spec_of("tour", 9, allocation=allocation)
        _, states, _ = flown(spec, ends={1: 8})
        assert states[-1].done.all()
        for state in states[:-1]:
            assert not state.finished.any() or state.done.all()
        assert (states[-1].target[1] == -1).all()


@pytest.mark.parametrize("ordered", [False, True])
def test_every_robot_visits_all_places_of_a_tour_that_is_not_shared(ordered: bool) -> None:
    _, states, _ = flown(spec_of("tour", 5, shared=False, ordered=ordered))
    last = states[-1]
    assert last.did.tolist() == [5, 5, 5]
    assert last.progress == 1.0
    visits = np.array([bits.unpack_flags(jnp.asarray(state.believed_over), 5) for state in states])
    if ordered:  # whoever has been at a place has been at all before it
        assert (visits[..., :-1] | ~visits[..., 1:]).all()
    assert visits[-1].all()


def test_robots_that_return_are_finished_at_home() -> None:
    task, states, _ = flown(spec_of("tour", 4, after="return"))
    last = states[-1]
    assert last.finished.all()
    homes = np.asarray(task.position_m)[4:]
    assert (np.linalg.norm(last.goal_m - homes, axis=1) <= 0.5).all()
    finished = np.array([state.finished for state in states]).any(axis=1)
    assert np.argmax(finished) > np.argmax([state.complete for state in states])


def test_a_robot_is_home_within_the_tolerance_of_its_start() -> None:
    """By its distance: 0.4 m off along two axes is beyond 0.5 m, 0.3, 0.3 and 0.2 m is not."""
    spec = spec_of("tour", 4, after="return")
    task, start = task_of(spec), np.asarray(Water().start_m)
    off = np.array([[0.4, 0.4, 0.0], [0.3, 0.3, 0.2], [0.0, 0.0, 0.6]])
    state = replace(task_update.begin_task(spec, task, jnp.asarray(start)), done=jnp.ones(4, bool))
    after = looked(spec, task, state, start + off, np.ones(ROBOTS, bool), 1.0, None)
    assert after.finished.tolist() == [False, True, False]


def test_goods_are_taken_by_robots_that_were_sent_for_them() -> None:
    """A robot that starts where goods lie takes them up once it is sent there, not before."""
    spec = spec_of("deliver", 4, dropped="lost")
    task, p = task_of(spec), np.asarray(Water().start_m).copy()
    p[0] = task.position_m[1]
    state = task_update.begin_task(spec, task, jnp.asarray(p))
    assert state.target.tolist() == [-1] * ROBOTS
    state = looked(spec, task, state, p, np.ones(ROBOTS, bool), 0.0, None)
    assert state.carrying.tolist() == [-1] * ROBOTS
    assert state.target[0] == 1
    state = looked(spec, task, state, p, np.ones(ROBOTS, bool), 0.5, None)
    assert state.carrying[0] == 1


def test_goods_are_conserved_and_each_is_brought_once() -> None:
    task, states, _ = flown(spec_of("deliver", 5, allocation="auction"))
    before = np.zeros(5, int)
    for state in states:
        carried = np.bincount(state.carrying[state.carrying >= 0], minlength=5)
        assert (carried + state.done <= 1).all()  # by one robot, and not once brought
        left_again = (before == 1) & (carried == 0) & ~state.done
        assert not left_again.any()
        assert np.array_equal(
            state.target[state.carrying >= 0], 5 + state.carrying[state.carrying >= 0]
        )
        before = carried
    assert states[-1].done.all()
    assert states[-1].complete
    assert task.position_m.shape == (13, 3)


@pytest.mark.parametrize("dropped", ["lost", "back"])
def test_goods_of_a_robot_that_ended_are_lost_or_back_where_they_lay(dropped: str) -> None:
    spec = spec_of("deliver", 4, dropped=dropped)
    _, whole, _ = flown(spec)
    first = next(i for i, state in enumerate(whole) if state.carrying[0] >= 0)
    goods = whole[first].carrying[0]
    _, states, _ = flown(spec, ends={0: first + 2})
    last = states[-1]
    assert last.finished[1:].all()
    assert (last.carrying == -1).all()
    if dropped == "lost":
        assert last.lost.sum() == 1
        assert last.lost[goods]
        assert not last.done[goods]
        assert not last.complete
    else:
        assert last.done.all()
        assert last.by[goods] != 0


def test_a_survey_ends_when_enough_was_seen() -> None:
    seen = visibility.build_footprint(math.radians(45.0), 5.0, CELL)
    survey = SurveySpec(of="floor", footprint=seen, altitude_cells=2, coverage=0.9)
    task, states, _ = flown(spec_of("survey", 20, survey=survey, timed=True))
    last = states[-1]
    cells = np.asarray(task.survey.cells)
    bits = (np.asarray(last.seen)[:, :, :1] >> np.arange(cells.shape[2])) & 1
    share = (bits.astype(bool) & cells).sum() / int(task.survey.count)
    assert share == pytest.approx(float(last.progress))
    at_s = last.seen_at_s[cells]
    for look, state in enumerate(states):  # when each cell was seen tells what had been seen when
        assert np.mean(at_s <= 0.5 * look) == pytest.approx(float(state.progress))
    assert share >= 0.9
    assert last.finished.all()
    before = [state.progress for state in states if not state.complete]
    assert max(before) < 0.9
    assert (np.diff([state.progress for state in states]) >= 0).all()


def survey_of(coverage: float) -> TaskSpec:
    seen = visibility.build_footprint(math.radians(45.0), 5.0, CELL)
    survey = SurveySpec(of="floor", footprint=seen, altitude_cells=2, coverage=coverage)
    return spec_of("survey", 20, survey=survey)


def cells_of(words: Any, shape: tuple[int, ...]) -> np.ndarray:
    """bool [nx, ny, nz] of packed words, by NumPy."""
    bits = np.unpackbits(np.asarray(words).view(np.uint8), axis=-1, bitorder="little")
    return bits[..., : shape[2]].astype(bool)


def test_a_survey_is_complete_with_the_cell_that_makes_its_coverage() -> None:
    """What is seen at once is exactly the coverage of the one, one cell less than of the other."""
    p, all_ = np.array([[0.0, 0.0, -6.0], [3.0, 3.0, -6.0], [-3.0, 3.0, -6.0]]), np.ones(3, bool)

    def after(coverage: float) -> tuple[TaskWorld, TaskState]:
        spec = survey_of(coverage)
        task = task_of(spec)
        begun = task_update.begin_task(spec, task, jnp.asarray(p))
        return task, looked(spec, task, begun, p, all_, 0.0, None)

    task, state = after(1.0)
    cells = np.asarray(task.survey.cells)
    count, total = int((cells_of(state.seen, SHAPE) & cells).sum()), int(cells.sum())
    assert 5 < count < total - 1
    assert not state.complete
    assert after(count / total)[1].complete
    assert not after((count + 1) / total)[1].complete


def test_viewpoints_are_credited_to_robots_that_are_under_way() -> None:
    """All is seen: each viewpoint is that of the nearest robot whose episode goes on."""
    spec = survey_of(1.0)
    task = task_of(spec)
    points, there = np.asarray(task.position_m)[: spec.jobs], np.asarray(task.exists)
    p, running = np.asarray(Water().start_m).copy(), np.array([True, False, True])
    p[1] = points[there].mean(axis=0)  # in the middle of them, and lost
    begun = replace(task_update.begin_task(spec, task, jnp.asarray(p)), seen=task.survey.words)
    state = looked(spec, task, begun, p, running, 1.0, None)
    apart = np.linalg.norm(points[:, None] - p, axis=-1)
    assert (np.argmin(apart[there], axis=1) == 1).any()
    expected = np.argmin(np.where(running, apart, np.inf), axis=1)
    assert np.asarray(state.by)[there].tolist() == expected[there].tolist()
    assert (np.asarray(state.by)[~there] == -1).all()
    assert state.did.tolist() == [int((expected[there] == robot).sum()) for robot in range(ROBOTS)]
    assert state.did[1] == 0


def test_robots_that_hear_nothing_know_their_own_work_alone_and_do_it_all_again() -> None:
    spec = spec_of("tour", 4)
    task, state = task_of(spec), None
    p = np.asarray(Water().start_m)
    state = task_update.begin_task(spec, task, jnp.asarray(p))
    running = np.ones(ROBOTS, bool)
    silence = heard()
    visits: list[set[int]] = [set() for _ in range(ROBOTS)]
    for look in range(LOOKS):
        state = looked(spec, task, state, p, running, 0.5 * look, silence)
        goal, places = np.asarray(state.goal_m), np.asarray(task.position_m)[:4]
        for robot in range(ROBOTS):
            near = np.linalg.norm(places - p[robot], axis=1) <= 0.5
            visits[robot] |= set(np.flatnonzero(near).tolist())
        if np.asarray(state.finished).all():
            break
        way = goal - p
        far = np.linalg.norm(way, axis=1, keepdims=True)
        p = p + way * np.minimum(1.0, STEP_M / np.maximum(far, 1e-9))
    assert all(seen == {0, 1, 2, 3} for seen in visits)
    assert np.asarray(state.done).all()
    known = bits.unpack_flags(state.believed_over, 4)
    assert known.all()


def test_robots_that_hear_nothing_come_back_for_more_goods() -> None:
    spec = spec_of("deliver", 5)
    task, p = task_of(spec), np.asarray(Water().start_m)
    state = task_update.begin_task(spec, task, jnp.asarray(p), heard=True)
    silence = heard()
    for look in range(2 * LOOKS):
        state = looked(spec, task, state, p, np.ones(ROBOTS, bool), 0.5 * look, silence)
        if np.asarray(state.finished).all():
            break
        way = np.asarray(state.goal_m) - p
        far = np.linalg.norm(way, axis=1, keepdims=True)
        p = p + way * np.minimum(1.0, STEP_M / np.maximum(far, 1e-9))
    assert np.asarray(state.done).all()
    assert np.asarray(state.did).sum() == 5  # each thing was brought by one of them, once
    assert np.asarray(state.finished).all()


def test_goods_of_a_carrier_that_fell_silent_are_fetched_from_where_they_were() -> None:
    spec = spec_of("deliver", 1, dropped="back")
    task, p = task_of(spec), np.asarray(Water().start_m)
    state = task_update.begin_task(spec, task, jnp.asarray(p), heard=True)
    carries = jnp.full((ROBOTS, ROBOTS), -1).at[:, 1].set(0)  # robot 1 says that it carries them

    def after(state: TaskState, t: float, active: bool, p: Any = p) -> TaskState:
        told = heard(active=active, carrying=carries)
        return looked(spec, task, state, p, np.array([True, False, False]), t, told)

    state = after(state, 0.0, True)
    assert state.target[0] == -1
    assert not state.finished[0]  # they are not brought yet
    state = after(state, 60.0, False)
    assert state.target[0] == 0
    # It comes there, takes them and brings them.
    at = p.copy()
    at[0] = task.position_m[0]
    state = after(state, 70.0, False, at)
    assert state.carrying[0] == 0
    at[0] = task.position_m[1]
    state = after(state, 80.0, False, at)
    assert bool(state.complete)


def test_an_empty_place_is_believed_until_its_goods_may_lie_there_again() -> None:
    spec = spec_of("deliver", 1, dropped="back")
    task, p = task_of(spec), np.asarray(Water().start_m).copy()
    state = task_update.begin_task(spec, task, jnp.asarray(p), heard=True)
    p[:2] = task.position_m[0]  # both come for them at a time, and hear nothing of each other
    both = np.array([True, True, False])
    state = replace(state, target=jnp.array([0, 0, -1]))
    state = looked(spec, task, state, p, both, 1.0, heard())
    assert state.carrying.tolist() == [0, -1, -1]
    assert state.target.tolist() == [1, -1, -1]
    state = looked(spec, task, state, Water().start_m, both, 50.0, heard())
    assert state.target[1] == -1
    state = looked(spec, task, state, Water().start_m, both, 62.0, heard())
    assert state.target[1] == 0


def test_what_is_heard_spares_the_way() -> None:
    spec = spec_of("tour", 4)
    task = task_of(spec)
    state = task_update.begin_task(spec, task, Water().start_m)
    said = bits.pack_flags(jnp.ones((ROBOTS, ROBOTS, 4), bool).at[:, :, 2].set(False))
    from_one = jnp.zeros_like(said).at[0, 1].set(said[0, 1])  # robot 0 has heard robot 1 alone
    alone = heard(over=from_one)
    after = looked(spec, task, state, Water().start_m, np.ones(ROBOTS, bool), 0.0, alone)
    known = np.asarray(bits.unpack_flags(after.believed_over, 4))
    assert known[0].tolist() == [True, True, False, True]
    assert not known[1:].any()
    assert after.target[0] == 2
    assert not after.finished.any()
