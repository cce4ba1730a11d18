"""Which worlds are chosen to be looked at."""

from types import SimpleNamespace

import numpy as np
import pyarrow as pa

from angler_mjx.report.viewing import world_selection


def _run(*worlds, tasks=None):
    """A run of worlds given as lists of (outcome, failure time, clearance).

    ``tasks`` holds progress and time of completion [s] of each world, None: not completed.
    """
    rows = [(index, *row) for index, rows in worlds for row in rows]
    world, outcome, failed, clearance = zip(*rows, strict=True)
    index = [i for i, (_, robots) in enumerate(worlds) for _ in robots]
    progress, completed_s = zip(*(tasks or [(None, None)] * len(worlds)), strict=True)
    table = pa.table(
        {
            "world": list(world),
            "outcome": list(outcome),
            "failure_time_s": np.array(failed, np.float32),
            "min_clearance_m": np.array(clearance, np.float32),
            "task_progress": pa.array([progress[i] for i in index], pa.float32()),
            "task_completed_s": pa.array([completed_s[i] for i in index], pa.float32()),
        }
    )
    return SimpleNamespace(episodes=table)


OK, TIGHT = ("reached", np.nan, 0.5), ("reached", np.nan, 0.1)
ROCK, LATE_ROCK = ("collision_static", 10.0, 0.0), ("collision_static", 20.0, 0.0)
TIMEOUT = ("timeout", 120.0, 0.4)


def test_worst_is_the_world_with_most_failures():
    run = _run((0, [OK, ROCK]), (1, [ROCK, ROCK]), (2, [OK, OK]))
    assert world_selection.worst_world(run) == 1


def test_worst_prefers_more_causes_then_the_earlier_failure_then_the_lower_index():
    more_causes = _run((0, [ROCK, ROCK]), (1, [ROCK, TIMEOUT]))
    assert world_selection.worst_world(more_causes) == 1
    earlier = _run((0, [LATE_ROCK, OK]), (1, [ROCK, OK]))
    assert world_selection.worst_world(earlier) == 1
    alike = _run((3, [ROCK, OK]), (5, [ROCK, OK]))
    assert world_selection.worst_world(alike) == 3


def test_good_is_the_tightest_world_in_which_most_arrived():
    run = _run((0, [OK, OK]), (1, [OK, TIGHT]), (2, [TIGHT, ROCK]))
    assert world_selection.good_world(run) == 1


def test_worlds_keep_their_global_index_where_tiles_are_missing():
    run = _run((128, [OK, OK]), (129, [ROCK, OK]))
    assert world_selection.worst_world(run) == 129
    assert world_selection.good_world(run) == 128


def test_a_run_in_which_nobody_fails_has_a_worst_world_all_the_same():
    assert world_selection.worst_world(_run((0, [OK]), (1, [OK]))) == 0


def test_worlds_of_a_task_are_chosen_by_its_completion():
    """World 1 is late though no robot failed, world 2 early though one did."""
    robots = [(0, [OK, TIGHT]), (1, [OK, OK]), (2, [OK, ROCK])]
    run = _run(*robots, tasks=[(1.0, 60.0), (1.0, 90.0), (1.0, 30.0)])
    assert world_selection.worst_world(run) == 1
    assert world_selection.good_world(run) == 0  # of those in which all did their part the earliest


def test_a_task_that_was_not_completed_is_worse_than_a_late_one():
    """Robots of a survey can all do their part without its being completed."""
    robots = [(0, [OK, OK]), (1, [ROCK, ROCK]), (2, [OK, OK]), (3, [ROCK, OK])]
    run = _run(*robots, tasks=[(0.9, None), (1.0, 110.0), (0.7, None), (0.7, None)])
    assert world_selection.worst_world(run) == 3  # as little was done as in 2, and a robot was lost
    assert world_selection.good_world(run) == 1
