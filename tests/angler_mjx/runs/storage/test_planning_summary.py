"""How planning ended: counted rows of a hand-made table."""

import numpy as np
import pytest

from angler_mjx.runs.simulator.host_planning import PlanNotes
from angler_mjx.runs.storage import planning_summary
from angler_mjx.runs.storage.confidence_intervals import wilson_interval

RAISED = "KeyError: 'start' (planner.py:7)"
OTHER = "KeyError: 'start' (planner.py:9)"


def of(*worlds):
    """Summary of worlds, each a status and a reason for each robot (None: it has a plan)."""
    rows = [
        (w, status, reason) for w, (status, *reasons) in enumerate(worlds) for reason in reasons
    ]
    return planning_summary.summarise_robots(
        np.array([w for w, _, _ in rows]),
        np.array([reason is None for _, _, reason in rows]),
        [status for _, status, _ in rows],
        [reason for _, _, reason in rows],
    )


def late(taken):
    return f"the planner missed its deadline of 5 s (took {taken} s)"


def test_reasons_are_counted_and_numbers_do_not_part_them():
    found = of(
        ("planned", None, None),
        ("error", RAISED, RAISED),
        ("error", OTHER, OTHER),
        ("timeout", late(6.25), late(6.25)),
        ("timeout", late(5.75), late(5.75)),
        ("partial", None, "begins 0.3 m from the robot's start"),
        ("none", "", ""),
    )
    assert found["robots"]["count"] == 3
    assert found["robots"]["rate"] == pytest.approx(3 / 14)
    assert found["worlds"] == {"error": 2, "none": 1, "partial": 1, "planned": 1, "timeout": 2}
    counts = {one["reason"]: (one["robots"], one["worlds"]) for one in found["reasons"]}
    assert counts == {
        late(6.25): (4, 2),  # the first of its kind stands for both
        RAISED: (2, 1),  # lines of a file are no measured numbers
        OTHER: (2, 1),
        planning_summary.NO_PATH: (2, 1),
        "begins 0.3 m from the robot's start": (1, 1),
    }
    assert (
        planning_summary.reason_lines(found)[0] == f"no plan for 4 robots in 2 worlds: {late(6.25)}"
    )
    assert planning_summary.planner_fault(found) is None


def test_the_fraction_has_the_interval_of_independent_worlds_where_each_has_one_robot():
    found = of(*([("planned", None)] * 30 + [("error", RAISED)] * 10))
    low, high = wilson_interval(30, 40)
    assert (found["robots"]["low"], found["robots"]["high"]) == pytest.approx((low, high))


@pytest.mark.parametrize(
    ("worlds", "fault"),
    [
        ([("error", RAISED)] * 3, f"planned none of 3 worlds: {RAISED}"),
        ([("died", "its process died, 2 times: exit code 3")],
         "planned none of 1 world: its process died, 2 times: exit code 3"),
        ([("error", RAISED), ("timeout", late(6))], None),
        ([("error", RAISED), ("planned", None)], None),
        ([("none", "no way")] * 3, None),
    ],
)  # fmt: skip
def test_a_command_fails_where_the_planner_raised_in_every_world(worlds, fault):
    assert planning_summary.planner_fault(of(*worlds)) == fault


def test_each_kind_of_failure_is_said_once_when_it_happens():
    said = []
    failures = planning_summary.PlanningFailures(said.append)
    for first, (status, reason) in enumerate(
        [("error", RAISED), ("error", RAISED), ("timeout", late(6)), ("timeout", late(7)),
         ("none", "no way"), ("error", OTHER)]
    ):  # fmt: skip
        notes = PlanNotes(
            planning_s=np.zeros(1),
            status=np.array([status], object),
            reason=np.full((1, 2), reason, object),
        )
        failures.add(np.array([10 + first]), notes)
    failures.add(np.array([0]), None)
    assert said == [
        f"world 10 has no plan: {RAISED}",
        f"world 12 has no plan: {late(6)}",
        f"world 15 has no plan: {OTHER}",
    ]
