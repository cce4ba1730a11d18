"""Planners of the host, asked from within a compiled policy."""

import jax
import numpy as np
import pytest

from angler_mjx.planning.online import host_replanner
from angler_mjx.planning.online.host_replanner import HostReplanner
from angler_mjx.planning.register import find

from ..problems import problem

PLANNER = '''
import numpy as np
from angler_mjx import NoPlan, way_points

class OneStays:
    """All but the last robot go straight; the last has no plan."""

    def plan(self, problem):
        ways = list(zip(problem.team.start_m, problem.team.goal_m))[:-1]
        return [way_points([0, 60], way) for way in ways] + [NoPlan("stays")]
'''


@pytest.fixture(autouse=True)
def ended():
    yield
    host_replanner.close_workers()


def test_a_compiled_policy_waits_for_the_plans_of_another_process(tmp_path):
    file = tmp_path / "planner.py"
    file.write_text(PLANNER)
    anew = HostReplanner(reference=find(f"{file}:OneStays"), settings=(), points=5)
    starts, goals = [[1, 1, 5], [1, 4, 5]], [[9, 1, 5], [9, 4, 6]]
    plans = jax.jit(anew)(problem(starts, goals))
    np.testing.assert_array_equal(plans.found, [True, False])
    np.testing.assert_array_equal(plans.time_s, [[0, 60, 60, 60, 60], [0] * 5])
    np.testing.assert_array_equal(plans.position_m[0], [starts[0]] + [goals[0]] * 4)
    np.testing.assert_array_equal(plans.position_m[1], [starts[1]] * 5)
