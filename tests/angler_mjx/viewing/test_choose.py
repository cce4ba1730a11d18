"""Which worlds are chosen to be looked at."""

from types import SimpleNamespace

import numpy as np
import pyarrow as pa

from angler_mjx.viewing import choose


def _run(*worlds):
    """A run of worlds given as lists of (outcome, failure time, clearance)."""
    rows = [(index, *row) for index, rows in worlds for row in rows]
    world, outcome, failed, clearance = zip(*rows, strict=True)
    table = pa.table(
        {
            "world": list(world),
            "outcome": list(outcome),
            "failure_time_s": np.array(failed, np.float32),
            "min_clearance_m": np.array(clearance, np.float32),
        }
    )
    return SimpleNamespace(episodes=table)


OK, TIGHT = ("reached", np.nan, 0.5), ("reached", np.nan, 0.1)
ROCK, LATE_ROCK = ("collision_static", 10.0, 0.0), ("collision_static", 20.0, 0.0)
TIMEOUT = ("timeout", 120.0, 0.4)


def test_worst_is_the_world_with_most_failures():
    run = _run((0, [OK, ROCK]), (1, [ROCK, ROCK]), (2, [OK, OK]))
    assert choose.worst_world(run) == 1


def test_worst_prefers_more_causes_then_the_earlier_failure_then_the_lower_index():
    more_causes = _run((0, [ROCK, ROCK]), (1, [ROCK, TIMEOUT]))
    assert choose.worst_world(more_causes) == 1
    earlier = _run((0, [LATE_ROCK, OK]), (1, [ROCK, OK]))
    assert choose.worst_world(earlier) == 1
    alike = _run((3, [ROCK, OK]), (5, [ROCK, OK]))
    assert choose.worst_world(alike) == 3


def test_good_is_the_tightest_world_in_which_most_arrived():
    run = _run((0, [OK, OK]), (1, [OK, TIGHT]), (2, [TIGHT, ROCK]))
    assert choose.good_world(run) == 1


def test_worlds_keep_their_global_index_where_tiles_are_missing():
    run = _run((128, [OK, OK]), (129, [ROCK, OK]))
    assert choose.worst_world(run) == 129
    assert choose.good_world(run) == 128


def test_a_run_in_which_nobody_fails_has_a_worst_world_all_the_same():
    assert choose.worst_world(_run((0, [OK]), (1, [OK]))) == 0
