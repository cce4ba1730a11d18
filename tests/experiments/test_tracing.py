"""Two flights made by hand: what differed first is found, with its time and size."""

from dataclasses import fields, replace

import numpy as np
import pytest

from angler_experiments import devices_parity
from angler_experiments.shared import flights, tracing
from angler_experiments.shared.flights import StudyFlight
from angler_experiments.shared.tracing import Cause
from angler_mjx.sim.state import Outcome, Touched

DT_S, STEPS, PHYSICS_STEPS = 0.05, 200, 5
W, R, K = 2, 2, 3
FIRST = (1, 0)
"""The world and robot that end otherwise."""


@pytest.fixture
def flight():
    """Robots that go along x at half a metre a second, obstacles that drift along y."""
    time = DT_S * np.arange(STEPS)
    p = np.zeros((W, STEPS, R, 3), np.float32)
    p[..., 0] = 0.5 * time[:, None]
    p[..., 1] = 3.0 * np.arange(R)
    obstacle = np.zeros((W, STEPS, K, 3), np.float32)
    obstacle[..., 1] = 0.2 * time[:, None]
    obstacle[..., 2] = -np.arange(K)
    return StudyFlight(
        cells=np.zeros((W, 2, 2, 2), bool),
        variant=np.zeros((W, R), int),
        start_m=p[:, 0],
        goal_m=p[:, -1],
        redraws=np.zeros(W, int),
        planned=np.ones((W, R), bool),
        plan_m=np.zeros((W, R, 4, 3), np.float32),
        plan_s=np.zeros((W, R, 4), np.float32),
        p=p,
        target_m=p + 0.1,
        pwm_us=np.full((W, STEPS, R, 8), 1500.0, np.float32),
        obstacle_p=obstacle,
        outcome=np.full((W, R), Outcome.REACHED),
        end_time_s=np.full((W, R), 9.0),
        path_length_m=np.full((W, R), 4.5),
        energy_j=np.full((W, R), 100.0),
        touched=np.zeros((W, R), int),
        touched_index=np.full((W, R), -1),
    )


def ended(flight, outcome, touched=Touched.NOTHING, index=-1, end_s=8.0):
    """The flight in which one robot ends otherwise."""
    changes = {
        "outcome": outcome,
        "touched": touched,
        "touched_index": index,
        "end_time_s": end_s,
    }
    changed = {}
    for name, value in changes.items():
        changed[name] = getattr(flight, name).copy()
        changed[name][FIRST] = value
    return replace(flight, **changed)


def moved(flight, name, at, by):
    """The flight in which something goes aside along z from a step on."""
    held = getattr(flight, name).copy()
    held[at][..., 2] += by
    return replace(flight, **{name: held})


def only(a, b):
    (found,) = tracing.trace_differences(a, b, DT_S, PHYSICS_STEPS)
    assert (found.world, found.robot) == FIRST
    return found


HIT = (Outcome.COLLISION_DYNAMIC, Touched.OBSTACLE, 2)
AFTER = (FIRST[0], slice(100, None))


def test_flights_that_end_alike_are_not_traced(flight):
    other = moved(flight, "p", (*AFTER, 0), 0.5)
    assert tracing.trace_differences(flight, other, DT_S, PHYSICS_STEPS) == []


def test_a_tie_of_the_planner(flight):
    other = replace(flight, plan_m=flight.plan_m + np.float32(0.75))
    found = only(flight, ended(other, *HIT))
    assert (found.cause, found.at_s) == (Cause.PLAN, 0.0)
    assert found.size_m == pytest.approx(0.75)


def test_another_world_comes_before_all(flight):
    other = replace(flight, cells=~flight.cells, plan_m=flight.plan_m + np.float32(0.75))
    assert only(flight, ended(other, *HIT)).cause is Cause.WORLD


def test_an_obstacle_that_drifts_away_and_one_that_is_thrown_back(flight):
    slowly = flight.obstacle_p.copy()
    slowly[FIRST[0], 100:, 2, 2] += 1e-4 * np.arange(STEPS - 100)
    found = only(flight, ended(replace(flight, obstacle_p=slowly), *HIT))
    assert found.cause is Cause.DRIFT
    thrown = flight.obstacle_p.copy()
    thrown[FIRST[0], 100:, 2, 1] -= 0.02 * np.arange(STEPS - 100)
    found = only(flight, ended(replace(flight, obstacle_p=thrown), *HIT))
    assert found.cause is Cause.BOUNCE
    assert found.at_s == pytest.approx(5.05)
    assert found.size_m == pytest.approx(0.02, rel=1e-3)
    assert found.before_m == 0.0


def test_an_obstacle_that_it_did_not_touch_is_no_cause(flight):
    other = moved(flight, "obstacle_p", (*AFTER, 0), 1.0)
    found = only(flight, ended(other, *HIT))
    assert found.cause is Cause.TOUCH
    assert found.at_s == 8.0
    assert found.size_m == 0.0


def test_the_other_robot(flight):
    other = moved(flight, "p", (*AFTER, 1), 0.3)
    found = only(flight, ended(other, Outcome.COLLISION_ROBOT, Touched.ROBOT, 1))
    assert (found.cause, found.at_s) == (Cause.ROBOT, 5.0)
    assert found.size_m == pytest.approx(0.3, rel=1e-3)


def test_where_it_aims_comes_before_where_it_goes(flight):
    aimed = moved(flight, "target_m", (*AFTER, 0), 0.2)
    other = moved(aimed, "p", (FIRST[0], slice(110, None), 0), 0.1)
    assert only(flight, ended(other, *HIT)).cause is Cause.AIM
    itself = moved(flight, "p", (*AFTER, 0), 0.1)
    assert only(flight, ended(itself, *HIT)).cause is Cause.SELF


def test_rounding_is_no_cause_but_its_size_is_told(flight):
    other = moved(flight, "p", (FIRST[0], slice(None), 0), 6e-7)
    found = only(flight, ended(other, Outcome.COLLISION_STATIC, Touched.CELL))
    assert found.cause is Cause.TOUCH
    assert found.size_m == pytest.approx(6e-7, rel=1e-2)
    assert only(flight, ended(other, Outcome.TIMEOUT)).cause is Cause.ARRIVAL
    timeout = ended(flight, Outcome.TIMEOUT)
    assert only(timeout, ended(other, Outcome.OUT_OF_BOUNDS)).cause is Cause.EDGE


def test_what_comes_after_the_first_end_is_no_cause(flight):
    other = moved(flight, "p", (FIRST[0], slice(170, None), 0), 1.0)
    assert only(flight, ended(other, *HIT, end_s=8.0)).cause is Cause.TOUCH


def test_a_flight_goes_through_a_file(flight, tmp_path):
    flights.save_flight(flight, tmp_path / "flight.npz")
    again = flights.load_flight(tmp_path / "flight.npz")
    for field in fields(flight):
        np.testing.assert_array_equal(getattr(again, field.name), getattr(flight, field.name))


def test_the_page_counts_and_lists_them(flight):
    other = ended(moved(flight, "p", (*AFTER, 0), 0.1), *HIT)
    traces = tracing.trace_differences(flight, other, DT_S, PHYSICS_STEPS)
    text = devices_parity.to_markdown(flight, other, traces, ("cpu", "gpu"))
    assert "of 4 robots 1 have another outcome" in text
    assert "arrivals 4 and 3" in text
    assert "| 1, 0 | reached, 9.00 s | collision_dynamic, 8.00 s | its own motion | 5.00 |" in text
    assert devices_parity.result_numbers(flight, other, traces)["other_end"].value == 1.0
    assert "What differed first" not in devices_parity.to_markdown(flight, flight, [], ("a", "b"))
