"""What a record tells of a task over time, against the states that it was recorded from."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from angler_mjx.world.tasks import visibility
from angler_mjx.world.tasks.history import GoodsStatus, RobotActivity, TaskHistory
from angler_mjx.world.tasks.spec import SurveySpec
from angler_mjx.world.tasks.surface_quads import surface_quads

from .test_task_update import CELL, flown, spec_of

LOOK_S = 0.5


def recorded(spec, ends=None):
    """A history made of no more than a run folder holds, and the states behind it."""
    task, states, under_way = flown(spec, ends)
    last, running = states[-1], np.array(under_way)
    # A robot that finishes at a look ends with it.
    over = ~running | np.array([state.finished for state in states])
    surveyed = task.survey is not None
    cells = np.asarray(task.survey.cells) if surveyed else None
    history = TaskHistory(
        spec=spec,
        time_s=LOOK_S * np.arange(len(states)),
        position_m=np.asarray(task.position_m),
        exists=np.asarray(task.exists),
        by=last.by,
        done_at_s=last.done_at_s,
        progress=np.array([state.progress for state in states]),
        did=np.array([state.did for state in states]),
        target=np.array([state.target for state in states]),
        carrying=np.array([state.carrying for state in states]),
        ended_s=np.where(over.any(axis=0), LOOK_S * np.argmax(over, axis=0), np.inf),
        completed_s=float(last.completed_s),
        cells=cells,
        seen_at_s=last.seen_at_s,
    )
    return SimpleNamespace(history=history, states=states, over=over, running=running)


@pytest.mark.parametrize("dropped", ["lost", "back"])
def test_goods_are_where_the_states_say(dropped):
    spec = spec_of("deliver", 6, dropped=dropped)
    # Robot 0 ends with something in its hands.
    _, states, _ = flown(spec)
    carries = next(k for k, state in enumerate(states) if state.carrying[0] >= 0)
    made = recorded(spec, ends={0: carries + 2})
    history, counts = made.history, {goods: 0 for goods in GoodsStatus}
    for k, state in enumerate(made.states):
        for job in range(6):
            holders = np.flatnonzero((state.carrying == job) & made.running[k])
            expected = GoodsStatus.WAIT
            if state.done[job]:
                expected = GoodsStatus.BROUGHT
            elif state.lost[job]:
                expected = GoodsStatus.LOST
            elif holders.size:
                expected = GoodsStatus.TRAVEL
                assert history.carrier[k, job] == holders[0]
            assert history.goods[k, job] == expected, (k, job)
            counts[expected] += 1
    assert all(
        counts[goods] for goods in (GoodsStatus.WAIT, GoodsStatus.TRAVEL, GoodsStatus.BROUGHT)
    )
    assert (counts[GoodsStatus.LOST] > 0) == (dropped == "lost")
    words = history.describe_progress(len(made.states) - 1)
    assert words.startswith("5 of 6 goods brought" if dropped == "lost" else "6 of 6 goods brought")
    assert ("1 lost" in words) == (dropped == "lost")
    assert ("complete after" in words) == (dropped == "back")


def test_goods_lie_at_their_places_or_with_their_robots():
    made = recorded(spec_of("deliver", 6))
    history = made.history
    p_m = np.random.default_rng(1).normal(size=(len(made.states), 3, 3)).astype(np.float32)
    at_m = history.goods_m(p_m)
    for k, state in enumerate(made.states):
        for job in range(6):
            holders = np.flatnonzero(state.carrying == job)
            if holders.size:
                expected = p_m[k, holders[0]]
            else:
                expected = history.position_m[job + 6 * bool(state.done[job])]
            np.testing.assert_array_equal(at_m[k, job], expected)


@pytest.mark.parametrize("after", ["hold", "return"])
def test_robots_that_go_wait_return_and_have_finished_are_told_apart(after):
    made = recorded(spec_of("tour", 5, after=after))
    found = set()
    for k, state in enumerate(made.states):
        np.testing.assert_array_equal(made.history.done[k], state.done)
        for robot in range(3):
            doing, target = made.history.doing[k, robot], int(state.target[robot])
            found.add(int(doing))
            if made.over[k, robot]:
                assert doing == RobotActivity.ENDED
                assert made.history.describe_activity(k, robot) == ""
            elif target < 0:
                assert made.history.describe_activity(k, robot) == "waits"
            elif target < 5:
                assert made.history.describe_activity(k, robot) == f"goes to place {target}"
            else:
                assert target == 5 + robot
                assert made.history.describe_activity(k, robot) == "returns"
    expected = {
        RobotActivity.GOES,
        RobotActivity.ENDED,
        RobotActivity.RETURNS if after == "return" else RobotActivity.WAITS,
    }
    assert expected <= found
    assert made.history.describe_progress(0).startswith(
        f"{int(made.states[0].done.sum())} of 5 places visited"
    )


def test_words_of_a_tour_of_all_count_visits():
    made = recorded(spec_of("tour", 4, shared=False))
    for k, state in enumerate(made.states):
        assert made.history.describe_progress(k).startswith(
            f"{int(state.did.sum())} of 12 visits made"
        )
    assert "complete after" in made.history.describe_progress(len(made.states) - 1)


def test_cells_were_seen_when_the_states_say():
    cone = visibility.build_footprint(math.radians(45.0), 5.0, CELL)
    survey = SurveySpec(of="floor", footprint=cone, altitude_cells=2, coverage=0.9)
    made = recorded(spec_of("survey", 20, survey=survey, timed=True))
    cells, total = made.history.cells, int(made.history.cells.sum())
    for k, state in enumerate(made.states):
        # Bits along z, six of one word.
        seen = ((state.seen >> np.arange(6, dtype=np.uint32)) & 1).astype(bool)[cells]
        np.testing.assert_array_equal(made.history.seen[k], seen)
        assert made.history.describe_progress(k).startswith(f"{seen.sum()} of {total} cells seen (")
    assert "90 % wanted" in made.history.describe_progress(0)


@pytest.mark.parametrize("of", ["floor", "rock", "both"])
def test_faces_are_those_behind_which_there_is_what_is_surveyed(of):
    rng = np.random.default_rng(3)
    occupied = rng.random((5, 6, 4)) < 0.3
    origin, floor_z = np.array([-3.0, 1.0, -9.0]), -8.4
    expected, cells = set(), np.zeros(occupied.shape, bool)
    for i, j, k in np.argwhere(~occupied):
        if origin[2] + 1.5 * (k + 0.5) < floor_z:
            continue
        for axis in range(3):
            for side in (-1, 1):
                there = [i, j, k]
                there[axis] += side
                inside = all(0 <= n < most for n, most in zip(there, occupied.shape, strict=True))
                rock = inside and occupied[tuple(there)]
                below = [origin[2] + 1.5 * (n + 0.5) for n in range(k) if not occupied[i, j, n]]
                ground = axis == 2 and side == -1 and not any(z > floor_z for z in below)
                if (rock and of != "floor") or (ground and of != "rock"):
                    cells[i, j, k] = True
                    expected.add((i, j, k, axis, side))
    found = surface_quads(of, cells, occupied, origin, 1.5, floor_z)
    order = np.argwhere(cells)
    shown = set()
    for centre, axis, cell in zip(found.centre_m, found.axis, found.cell, strict=True):
        middle = origin + 1.5 * (order[cell] + 0.5)
        away = centre - middle
        assert (np.abs(away[[a for a in range(3) if a != axis]]) < 1e-9).all()
        side = int(np.sign(away[axis]))
        assert 0.0 < abs(away[axis]) < 0.75
        assert centre[2] > floor_z
        shown.add((*order[cell].tolist(), int(axis), side))
    assert len(found.axis) == len(expected)
    assert shown == expected
