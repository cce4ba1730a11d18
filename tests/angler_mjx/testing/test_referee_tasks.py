"""The referee's judgement of tasks, on flights of which every number is known in closed form."""

import numpy as np
import pytest

from angler_mjx.testing import referee
from angler_mjx.testing.referee import sight

from .hand_made import (
    CELLS,
    DT_S,
    EDGE_M,
    LOW_M,
    OUTCOMES,
    Flight,
    edit_array,
    edit_rows,
    row,
    straight,
    write,
)

STEPS, LOOK = 100, 10
"""5 s, a look every 0.5 s."""
PWM_W = 12.8
"""Of a T200 at 1600 us and 16 V, by its table."""
CAP_M = EDGE_M - (np.hypot(np.hypot(0.1015, 0.1605), 0.011) + 0.127)
"""Clearance of a Heavy that is far from everything: an edge less the hull's reach."""
FAR_M = (5.0, 5.0, -2.0)
TASK = {"tolerance_m": 0.3, "look_s": LOOK * DT_S, "after": "hold"}
NAN = np.nan


def flight(task, once, over_time, robots, ends, columns, **more):
    """Robots (start, velocity), the outcome and the state that ended each, and their columns."""
    p, nu, q = [], [], []
    for (start, velocity), (name, end) in zip(robots, ends, strict=True):
        held = end if name not in ("reached", "timeout") else None
        for part, values in zip(
            (p, nu, q), straight(start, velocity, STEPS, end=held), strict=True
        ):
            part.append(values)
    p, nu, q = (np.concatenate(part, axis=1) for part in (p, nu, q))
    outcome = np.zeros(p.shape[:2], int)
    for i, (name, end) in enumerate(ends):
        outcome[end:, i] = 0 if name == "timeout" else OUTCOMES[name]
    rows = [
        row(
            name,
            end * DT_S,
            p[end, i],
            energy_j=8 * PWM_W * end * DT_S,
            path_length_m=float(np.linalg.norm(p[end, i] - p[0, i])),
            min_clearance_m=CAP_M,
            min_separation_m=1.0,
            **columns[i],
        )
        for i, (name, end) in enumerate(ends)
    ]
    return Flight(
        p=p,
        nu=nu,
        q=q,
        pwm=np.full((STEPS, len(robots), 8), 1600.0),
        outcome=outcome,
        goal=np.array([FAR_M] * len(robots)),
        rows=rows,
        task={**TASK, **task},
        task_once={name: np.asarray(values) for name, values in once.items()},
        task_over_time=over_time,
        **more,
    )


def by_time(values):
    """[T + 1, R] of values that hold from some looks on: {look: [R]}."""
    made = np.zeros((STEPS + 1, len(values[0])), int)
    for look, value in sorted(values.items()):
        made[look * LOOK :] = value
    return made


def judged(path, *quantities):
    """Findings of a run by quantity that do not agree, of those that are asked for."""
    verdict = referee.judge(path)
    wanted = quantities or (*referee.TASK_QUANTITIES, "outcome", "end_time_s")
    return {(x.quantity, x.robot): x for x in verdict.differences if x.quantity in wanted}, verdict


# Robot 0 goes east with 1 m/s from x = -4: at 2.0 s it is 0 m from place 0, at 3.0 s 0.1 m from
# place 1. Robot 1 stands, and has nothing left then either.
LANE = ((-4.0, 0.0, -6.0), (1.0, 0.0, 0.0))
ASIDE = ((0.0, 4.0, -6.0), (0.0, 0.0, 0.0))


def a_tour(places=((-2.0, 0.0, -6.0), (-0.9, 0.0, -6.0)), done_s=(2.0, 3.0), **task):
    end = round(max(done_s) / DT_S) + 1
    columns = [
        {"jobs_done": done, "task_progress": 1.0, "task_completed_s": max(done_s)}
        for done in (2, 0)
    ]
    return flight(
        {"type": "tour", "shared": True, "ordered": False, **task},
        {
            "place_m": np.array([*places, LANE[0], ASIDE[0]], np.float32),
            "exists": np.ones(2, np.uint8),
            "by": np.zeros(2, np.int16),
            "done_at_s": np.array(done_s, np.float32),
        },
        {"target": by_time({0: [0, -1]}), "carrying": by_time({0: [-1, -1]})},
        (LANE, ASIDE),
        [("reached", end)] * 2,
        columns,
    )


def a_delivery():
    """Robot 0 takes goods 0 at 1.0 s and brings them at 3.0 s; robot 1 leaves with goods 1.

    It takes them at 0.5 s and is outside at 2.05 s; the look at 2.5 s finds them lost, so robot 0
    has nothing left at 3.0 s, and the task is not completed.
    """
    leaving = ((-4.0, 4.0, -6.0), (-1.0, 0.0, 0.0))
    places = [(-3.0, 0.0, -6.0), (-4.5, 4.0, -6.0), (-1.1, 0.0, -6.0), (0.0, 4.0, -6.0)]
    return flight(
        {"type": "deliver", "dropped": "lost"},
        {
            "place_m": np.array([*places, LANE[0], leaving[0]], np.float32),
            "exists": np.ones(2, np.uint8),
            "by": np.array([0, -1], np.int16),
            "done_at_s": np.array([3.0, NAN], np.float32),
        },
        {
            "target": by_time({0: [0, 1], 1: [0, 3], 2: [2, 3], 5: [2, -1], 6: [-1, -1]}),
            "carrying": by_time({0: [-1, -1], 1: [-1, 1], 2: [0, 1], 5: [0, -1], 6: [-1, -1]}),
        },
        (LANE, leaving),
        [("reached", 61), ("out_of_bounds", 41)],
        [{"jobs_done": n, "task_progress": 0.5, "task_completed_s": NAN} for n in (1, 0)],
    )


def a_survey(coverage=0.5):
    """Two robots 3 m above the lowest cells' centres see what is within 3 m beside them (45 deg).

    Robot 0 goes east; robot 1 leaves the world at once. Cells are the lowest of three rows of
    columns about robot 0's way. Viewpoint 0 lies on the way, 1 is done in passing, 2 by nobody.
    """
    start = np.array([-4.0, 0.0, LOW_M[2] + 0.5 * EDGE_M + 3.0])
    leaving = ((-5.97, 4.0, -6.0), (-1.0, 0.0, 0.0))
    cells = np.zeros(CELLS, np.uint8)
    seen_s = np.full(CELLS, NAN, np.float32)
    for i in range(CELLS[0]):
        for j in (3, 4, 5):
            x, y = LOW_M[0] + EDGE_M * (i + 0.5), LOW_M[1] + EDGE_M * (j + 0.5)
            cells[i, j, 0] = 1
            looks = 0.5 * np.arange(STEPS // LOOK)
            sees = np.hypot(x - (start[0] + looks), y - start[1]) <= 3.0
            if sees.any():
                seen_s[i, j, 0], cells[i, j, 0] = looks[sees.argmax()], 2
    times = np.sort(seen_s[cells > 0])  # NaN last
    needed = int(np.ceil(coverage * len(times) - 1e-9))
    completed_s = float(times[needed - 1])
    end = round(completed_s / DT_S) + 1
    points = start + np.array([(1.0, 0.0, 0.0), (3.0, 1.0, 0.0), (8.0, 4.0, 1.0)])
    made = flight(
        {
            "type": "survey",
            "of": "floor",
            "half_angle_deg": 45.0,
            "range_m": 5.0,
            "coverage": coverage,
        },
        {
            "place_m": np.array([*points, start, leaving[0]], np.float32),
            "exists": np.ones(3, np.uint8),
            "by": np.array([0, 0, -1], np.int16),
            "done_at_s": np.array([1.0, 0.5, NAN], np.float32),
            "cells": cells,
            "seen_at_s": seen_s,
        },
        {"target": by_time({0: [0, 2]}), "carrying": by_time({0: [-1, -1]})},
        ((tuple(start), (1.0, 0.0, 0.0)), leaving),
        [("reached", end), ("out_of_bounds", 1)],
        [{"jobs_done": n, "task_progress": 0.0, "task_completed_s": completed_s} for n in (2, 0)],
    )
    last = STEPS // LOOK if end > STEPS else (end - 1) // LOOK + 1
    # Nobody looks after the end of the last robot.
    late = seen_s > (last - 1) * 0.5 + 1e-6
    made.task_once["seen_at_s"] = np.where(late, NAN, seen_s).astype(np.float32)
    made.task_once["cells"] = np.where(late & (cells == 2), 1, cells).astype(np.uint8)
    share = float(np.mean(made.task_once["cells"][cells > 0] == 2))
    for one in made.rows:
        one["task_progress"] = share
    return made


KINDS = {"tour": a_tour, "delivery": a_delivery, "survey": a_survey}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("every", [1, 5, 10])
def test_a_task_that_was_flown_as_stored_agrees(tmp_path, kind, every):
    """Also where samples are sparser than control steps, as long as each look is one."""
    found, verdict = judged(write(tmp_path / "run", KINDS[kind](), every=every))
    assert [one.line() for one in found.values()] == []
    assert verdict.conclusion == ("agrees" if every == 1 else "inconclusive")
    counts = verdict.counts
    for name in referee.TASK_QUANTITIES:
        # Which cells are a viewpoint's is not stored.
        is_bounded = kind == "survey" and name in ("jobs_done", "task")
        assert (counts[name].exact, counts[name].bounded) == ((0, 2) if is_bounded else (2, 0))
    if every == 1:
        assert counts["outcome"].exact == 2  # who has nothing left is known from the tracks


def test_where_looks_lie_between_samples_nothing_is_claimed(tmp_path):
    found, verdict = judged(write(tmp_path / "run", a_tour(), every=4))
    assert found == {}
    assert [verdict.counts[name].unchecked for name in referee.TASK_QUANTITIES] == [2] * 4


ROWS = [
    ("tour", 0, {"task_completed_s": 3.5}, "task_completed_s"),
    ("tour", 0, {"task_completed_s": NAN}, "task_completed_s"),
    ("tour", 0, {"task_progress": 0.5}, "task_progress"),
    ("tour", 0, {"jobs_done": 1}, "jobs_done"),
    ("tour", 1, {"jobs_done": 1}, "jobs_done"),
    ("tour", 1, {"time_to_goal_s": 2.55}, "outcome"),
    ("tour", 1, {"time_to_goal_s": 3.55}, "outcome"),
    ("delivery", 0, {"task_completed_s": 3.0}, "task_completed_s"),
    ("delivery", 0, {"task_progress": 1.0}, "task_progress"),
    ("delivery", 1, {"jobs_done": 1}, "jobs_done"),
    ("survey", 0, {"jobs_done": 3}, "jobs_done"),
    ("survey", 1, {"jobs_done": 1}, "jobs_done"),
    ("survey", 0, {"task_progress": 0.9}, "task_progress"),
    ("survey", 0, {"task_completed_s": 2.5}, "task_completed_s"),
]


@pytest.mark.parametrize(("kind", "robot", "change", "quantity"), ROWS)
def test_results_that_differ_from_the_tracks_disagree(tmp_path, kind, robot, change, quantity):
    path = write(tmp_path / "run", KINDS[kind]())
    edit_rows(path, 0, robot, **change)
    found, verdict = judged(path)
    assert not verdict.agrees
    assert found[quantity, robot].result == "disagrees"


def set_to(value):
    return lambda old: np.full_like(old, value)


ARRAYS = [
    ("tour", "task/done_at_s", (0, 1), 3.5, "job 1: stored by robot 0 at 3.5 s, judged"),
    ("tour", "task/by", (0, 0), 1, "job 0: stored by robot 1 at 2 s, judged by robot 0 at 2 s"),
    ("delivery", "task/carrying", (0, slice(30, 40), 0), -1, "robot 0 is stored with goods -1"),
    ("delivery", "task/by", (0, 1), 1, "job 1: stored by robot 1 never, judged by robot -1 never"),
    ("survey", "task/by", (0, 1), 1, "job 1: stored by robot 1 at 0.5 s: robot 0 was nearest"),
    ("survey", "task/done_at_s", (0, 0), 1.5, "job 0: stored by robot 0 at 1.5 s: a robot was"),
    ("survey", "task/done_at_s", (0, 0), 1.26, "at no look: no robot can have done it"),
    ("survey", "task/seen_at_s", (0, 2, 4, 0), 1.0, "cell (2, 4, 0): stored as seen at 1 s"),
    ("survey", "task/seen_at_s", (0, 7, 4, 0), 0.0, "cell (7, 4, 0): stored as seen at 0 s"),
    ("survey", "task/cells", (0, 4, 4, 1), 1, "cell (4, 4, 1) is no water at what is surveyed"),
]


@pytest.mark.parametrize(("kind", "array", "where", "value", "said"), ARRAYS)
def test_a_record_that_cannot_be_disagrees(tmp_path, kind, array, where, value, said):
    path = write(tmp_path / "run", KINDS[kind]())
    edit_array(path, array, where, set_to(value))
    found, verdict = judged(path, "task")
    assert not verdict.agrees
    assert said in found["task", 0].note


def test_a_survey_is_complete_with_the_cell_that_makes_its_coverage(tmp_path):
    """One look later, the results would ask for one cell more."""
    for number, coverage in enumerate((0.25, 0.5, 0.75)):
        made = a_survey(coverage)
        path = write(tmp_path / f"run_{number}", made)
        assert judged(path)[1].agrees
        later = made.rows[0]["task_completed_s"] + 0.5
        for robot in range(2):
            edit_rows(path, 0, robot, task_completed_s=later)
        assert judged(path)[0]["task_completed_s", 0].judged == pytest.approx(later - 0.5)


def test_what_rounding_can_have_turned_is_undecided(tmp_path):
    """At 2.0 s place 0 is 0.3 m ahead, to the last place of float32: it counts then or at 2.5 s."""
    places = ((-1.7, 0.0, -6.0), (-0.9, 0.0, -6.0))
    for number, first_s in enumerate((2.0, 2.5)):
        path = write(tmp_path / f"run_{number}", a_tour(places, done_s=(first_s, 3.0)))
        found, verdict = judged(path)
        results = {one.result for one in found.values()}
        assert results <= {"undecided"}
    assert (
        "0 m beyond" in verdict.differences[-1].note
        or "e-08 m beyond" in verdict.differences[-1].note
    )


def test_robots_that_know_what_they_heard_finish_when_they_know(tmp_path):
    """Of runs with modems it is not judged who has nothing left, but what is done."""
    path = write(tmp_path / "run", a_tour())
    config = (path / "config.json").read_text()
    talks = config.replace('"task":', '"acoustics": {"model": "range"}, "task":')
    (path / "config.json").write_text(talks)
    edit_rows(path, 0, 1, time_to_goal_s=4.05, energy_j=8 * PWM_W * 4.05)
    edit_array(path, "outcome", (0, slice(61, 81), 1), set_to(0))
    found, verdict = judged(path)
    assert verdict.conclusion == "inconclusive"
    assert found == {}
    assert verdict.counts["task_completed_s"].exact == 2


@pytest.mark.parametrize("share", [0.1, 0.3])
def test_lines_of_sight_are_those_of_points_along_them(share):
    """Against 4,001 points on each line; lines that graze an edge may be either."""
    random = np.random.default_rng(5)
    rock = random.random((7, 6, 5)) < share
    judged_cells = 0
    for _ in range(20):
        begin = random.uniform(0.0, (7, 6, 5))
        cells = np.argwhere(~rock)
        is_hidden, can_be_hidden = sight.find_hidden(rock, begin, cells)
        assert not (is_hidden & ~can_be_hidden).any()
        line = np.linspace(0.0, 1.0, 4001)[:, None]
        for cell, hid, may in zip(cells, is_hidden, can_be_hidden, strict=True):
            at = np.floor(begin + line * (cell + 0.5 - begin)).astype(int)
            at = at[np.any(at != np.floor(begin).astype(int), axis=1)]
            met = bool(rock[tuple(at.T)].any())
            judged_cells += hid == may
            assert hid <= met or may
            if hid == may and not met:
                assert not hid
            if met:
                assert may
    assert judged_cells > 1000
