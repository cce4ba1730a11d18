"""The book-keeping of one robot against numbers worked out by hand."""

import dataclasses
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.robot.control.commands import ThrusterPwm
from angler_mjx.robot.vehicles import library, params
from angler_mjx.sim import robot
from angler_mjx.sim.detection import Contact
from angler_mjx.sim.physics.step import VehicleState
from angler_mjx.sim.state import Outcome, SimSpec, Tally, Touched

# A control step of 0.1 s, from t = 4 s on, in a box of 12 m; numbers that float32 rounds little.
SPEC = SimSpec(physics_dt_s=0.02, physics_steps=5, goal_tolerance_m=0.5)
LO, HI = (-6.0, -5.0, -14.0), (6.0, 5.0, -2.0)
NAN = float("nan")

# A robot on its way moves by (0.3, 0.4, 0), half a metre, at 30 W, near nothing.
CALM = {
    "before": (0.0, 0.0, -8.0),
    "after": (0.3, 0.4, -8.0),
    "goal": (3.0, 3.0, -5.0),
    "clearance": 2.0,
    "separation": 0.95,
    "nearest": Touched.CELL,
    "index": -1,
    "static": True,
    "closing": 0.25,
    "broken": False,
    "outcome": Outcome.RUNNING,
}
HELD = {
    "outcome": Outcome.RUNNING,
    "end_time_s": 4.1,
    "path_length_m": 2.5,
    "energy_j": 10.0,
    "min_clearance_m": 1.5,
    "min_separation_m": 0.75,
    "touched": Touched.NOTHING,
    "touched_index": -1,
    "impact_speed_mps": NAN,
}
BEFORE = {
    "end_time_s": 4.0,
    "path_length_m": 2.0,
    "energy_j": 7.0,
    "min_clearance_m": 1.5,
    "min_separation_m": 0.75,
    "touched": Touched.NOTHING,
    "touched_index": -1,
    "impact_speed_mps": NAN,
}
"""The tally before the step: 7 J, 2 m, and what was least so far."""


def out(**place):
    """Beyond a face of the box by 10 cm: nothing else happens."""
    axis = "xyz".index(next(iter(place)))
    after = list(CALM["after"])
    after[axis] = place["xyz"[axis]]
    before = list(after)
    before[axis] += 0.5 if after[axis] < 0 and after[axis] < LO[axis] else -0.5
    return {"before": before, "after": after}, {"outcome": Outcome.OUT_OF_BOUNDS}


ROBOT = {"nearest": Touched.ROBOT, "index": 3, "separation": -0.01, "static": False}
MET_ROBOT = {
    "outcome": Outcome.COLLISION_ROBOT,
    "min_separation_m": -0.01,
    "touched": Touched.ROBOT,
    "touched_index": 3,
    "impact_speed_mps": 0.25,
}
AT_GOAL = {"goal": (0.3, 0.4, -8.25)}
DRIFTING = {"nearest": Touched.OBSTACLE, "index": 5, "clearance": -0.02, "static": False}
MET_OBSTACLE = {
    "outcome": Outcome.COLLISION_DYNAMIC,
    "min_clearance_m": -0.02,
    "touched": Touched.OBSTACLE,
    "touched_index": 5,
    "impact_speed_mps": 0.25,
}
CASES = {
    "on its way": ({}, {}),
    "nearer than ever": (
        {"clearance": 1.25, "separation": 0.5},
        {"min_clearance_m": 1.25, "min_separation_m": 0.5},
    ),
    "arrived": (AT_GOAL, {"outcome": Outcome.REACHED}),
    "arrived at the edge of the tolerance": (
        {"goal": (0.3, 0.4, -7.51)},
        {"outcome": Outcome.REACHED},
    ),
    "not quite arrived": ({"goal": (0.3, 0.4, -7.49)}, {}),
    "near the goal in the plane only": ({"goal": (0.3, 0.4, -10.0)}, {}),
    "met a robot": (ROBOT, MET_ROBOT),
    "met a robot by touching it": (
        ROBOT | {"separation": 0.0},
        MET_ROBOT | {"min_separation_m": 0.0},
    ),
    "met a drifting obstacle": (DRIFTING, MET_OBSTACLE),
    "met a standing obstacle": (
        DRIFTING | {"static": True},
        MET_OBSTACLE | {"outcome": Outcome.COLLISION_STATIC},
    ),
    "met rock": (
        {"clearance": -0.02},
        {
            "outcome": Outcome.COLLISION_STATIC,
            "min_clearance_m": -0.02,
            "touched": Touched.CELL,
            "impact_speed_mps": 0.25,
        },
    ),
    "met the floor": (
        {"clearance": 0.0, "nearest": Touched.FLOOR},
        {
            "outcome": Outcome.COLLISION_STATIC,
            "min_clearance_m": 0.0,
            "touched": Touched.FLOOR,
            "impact_speed_mps": 0.25,
        },
    ),
    "met a robot at its goal": (ROBOT | AT_GOAL, MET_ROBOT),
    "met an obstacle at its goal": (DRIFTING | AT_GOAL, MET_OBSTACLE),
    "met an obstacle outside": (
        DRIFTING | {"before": (5.8, 0.4, -8.0), "after": (6.3, 0.4, -8.0)},
        MET_OBSTACLE,
    ),
    "beyond -x": out(x=-6.1),
    "beyond +x": out(x=6.1),
    "beyond -y": out(y=-5.1),
    "beyond +y": out(y=5.1),
    "beyond the bottom": out(z=-14.1),
    "beyond the top": out(z=-1.9),
    "on the faces": ({"before": (6.0, 5.0, -2.5), "after": (6.0, 5.0, -2.0)}, {}),
    "at a goal that lies outside": (
        {"before": (5.8, 0.4, -8.0), "after": (6.3, 0.4, -8.0), "goal": (6.2, 0.4, -8.0)},
        {"outcome": Outcome.OUT_OF_BOUNDS},
    ),
    "diverged": ({"broken": True}, {"outcome": Outcome.DIVERGED}),
    "diverged into a robot": (
        ROBOT | {"broken": True},
        {"outcome": Outcome.DIVERGED, "min_separation_m": -0.01},
    ),
}
ENDED = [outcome for outcome in Outcome if outcome != Outcome.RUNNING]
"""Whatever happens afterwards, a tally that is closed stays as it is."""
ALL_AT_ONCE = ROBOT | AT_GOAL | {"clearance": -1.0, "separation": -1.0}
for _outcome in ENDED:
    CASES[f"after {_outcome.name}"] = (
        ALL_AT_ONCE | {"outcome": _outcome},
        BEFORE | {"outcome": _outcome},
    )


def tally_of(outcome):
    kept = {name: jnp.asarray(value, float) for name, value in BEFORE.items()}
    whole = {name: jnp.asarray(BEFORE[name], jnp.int32) for name in ("touched", "touched_index")}
    early = jnp.zeros(jnp.shape(outcome), bool)
    return Tally(outcome=jnp.asarray(outcome, jnp.int32), passed_early=early, **(kept | whole))


def contact_of(given):
    return Contact(
        clearance_m=jnp.asarray(given["clearance"], float),
        separation_m=jnp.asarray(given["separation"], float),
        nearest=jnp.asarray(given["nearest"], jnp.int32),
        nearest_index=jnp.asarray(given["index"], jnp.int32),
        nearest_is_static=jnp.asarray(given["static"]),
        closing_speed_mps=jnp.asarray(given["closing"], float),
    )


@pytest.fixture(scope="module")
def tallies():
    """The tally after the step, by the name of the case; compiled once for all."""
    rows = [CALM | changed for changed, _ in CASES.values()]
    each = {name: jnp.array([row[name] for row in rows]) for name in CALM}
    contacts = jax.vmap(contact_of)(each)
    before = jax.vmap(tally_of)(each["outcome"])

    def one(goal, tally, p, to, contact, broken):
        power, t = jnp.asarray(30.0), jnp.asarray(4.0)
        box = jnp.array(LO), jnp.array(HI)
        return robot.update_tally(SPEC, goal, *box, tally, p, to, contact, power, broken, t)

    found = jax.jit(jax.vmap(one))(
        each["goal"], before, each["before"], each["after"], contacts, each["broken"]
    )
    found = jax.tree.map(np.asarray, found)
    return {name: jax.tree.map(lambda x, i=i: x[i], found) for i, name in enumerate(CASES)}


@pytest.mark.parametrize("case", CASES)
def test_a_step_is_accounted_for(tallies, case):
    found, expected = tallies[case], HELD | CASES[case][1]
    for name, value in expected.items():
        # float32 rounding of sums of some metres, seconds and joules.
        np.testing.assert_allclose(getattr(found, name), value, atol=2e-6, err_msg=name)
    for name in ("outcome", "touched", "touched_index"):
        assert getattr(found, name).dtype == np.int32


OUT = {"before": (5.8, 0.4, -8.0), "after": (6.3, 0.4, -8.0)}
LATER, NOW = 4.15, 4.05
"""The step ends at 4.1 s."""
TASKS = {
    "on its way, at what would be a goal": (AT_GOAL, False, LATER, Outcome.RUNNING),
    "finished, far from a goal": ({}, True, LATER, Outcome.REACHED),
    "breaks down": ({}, False, NOW, Outcome.FAILED),
    "breaks down when it finishes": ({}, True, NOW, Outcome.FAILED),
    "leaves when it breaks down": (OUT, False, NOW, Outcome.OUT_OF_BOUNDS),
    "leaves when it finishes": (OUT, True, LATER, Outcome.OUT_OF_BOUNDS),
    "meets a robot when it breaks down": (ROBOT, True, NOW, Outcome.COLLISION_ROBOT),
    "diverges when it breaks down": ({"broken": True}, True, NOW, Outcome.DIVERGED),
    "has ended before": ({"outcome": Outcome.TIMEOUT}, True, NOW, Outcome.TIMEOUT),
}


def test_a_task_says_who_has_finished_and_whatever_is_worse_comes_first():
    rows = [CALM | changed for changed, *_ in TASKS.values()]
    each = {name: jnp.array([row[name] for row in rows]) for name in CALM}

    def one(given, finished, fails_at_s):
        return robot.update_tally(
            SPEC,
            given["goal"],
            jnp.array(LO),
            jnp.array(HI),
            tally_of(given["outcome"]),
            given["before"],
            given["after"],
            contact_of(given),
            jnp.asarray(30.0),
            given["broken"],
            jnp.asarray(4.0),
            finished,
            fails_at_s,
        ).outcome

    _, finished, fails_at_s, expected = zip(*TASKS.values(), strict=True)
    found = jax.jit(jax.vmap(one))(each, jnp.array(finished), jnp.array(fails_at_s))
    assert dict(zip(TASKS, map(Outcome, found.tolist()), strict=True)) == dict(
        zip(TASKS, expected, strict=True)
    )


PASSES = {
    "on its way": ({}, False, Outcome.RUNNING, False),
    "arrives": (AT_GOAL, True, Outcome.REACHED, False),
    "passes its goal early": (AT_GOAL, False, Outcome.RUNNING, True),
    "meets a robot at its goal, early": (ROBOT | AT_GOAL, False, Outcome.COLLISION_ROBOT, True),
    "has ended before": (AT_GOAL | {"outcome": Outcome.TIMEOUT}, False, Outcome.TIMEOUT, False),
}


def test_a_robot_arrives_on_the_last_approach_of_its_plan_alone():
    rows = [CALM | changed for changed, *_ in PASSES.values()]
    each = {name: jnp.array([row[name] for row in rows]) for name in CALM}

    def one(given, approaching):
        after = robot.update_tally(
            SPEC,
            given["goal"],
            jnp.array(LO),
            jnp.array(HI),
            tally_of(given["outcome"]),
            given["before"],
            given["after"],
            contact_of(given),
            jnp.asarray(30.0),
            given["broken"],
            jnp.asarray(4.0),
            approaching=approaching,
        )
        return after.outcome, after.passed_early

    _, approaching, outcome, early = zip(*PASSES.values(), strict=True)
    found = jax.jit(jax.vmap(one))(each, jnp.array(approaching))
    assert tuple(map(Outcome, found[0].tolist())) == outcome
    assert tuple(found[1].tolist()) == early


FAST, BRISK = (9.0, -9.0, 9.0, -9.0, 9.0, -9.0), (8.0, -8.0, 8.0, -8.0, 8.0, -8.0)
"""54 and 48 in all: either side of a speed of nonsense, 50."""


def states(nu=(0.5,) * 6, p=(1.0, 2.0, 3.0), q=(0.0, 1.0, 0.0, 0.0)):
    """Before, and what physics made of it."""
    before = VehicleState(
        p=jnp.array([0.0, 0.0, -8.0]),
        q=jnp.array([1.0, 0.0, 0.0, 0.0]),
        nu=jnp.full(6, 0.25),
        force_before=jnp.full(6, 3.0),
        thrust=jnp.full(4, 7.0),
    )
    after = VehicleState(
        p=jnp.array(p),
        q=jnp.array(q),
        nu=jnp.array(nu),
        force_before=jnp.full(6, 4.0),
        thrust=jnp.full(4, 8.0),
    )
    return before, after


@pytest.mark.parametrize(
    ("outcome", "change", "goes_on", "diverged"),
    [
        (Outcome.RUNNING, {}, True, False),
        (Outcome.REACHED, {}, True, False),
        *[(ended, {}, False, False) for ended in ENDED if ended != Outcome.REACHED],
        (Outcome.RUNNING, {"nu": BRISK}, True, False),
        (Outcome.RUNNING, {"nu": FAST}, False, True),
        (Outcome.REACHED, {"nu": FAST}, False, True),
        (Outcome.COLLISION_ROBOT, {"nu": FAST}, False, False),
        (Outcome.RUNNING, {"nu": (NAN, 0, 0, 0, 0, 0)}, False, True),
        (Outcome.RUNNING, {"p": (0.0, float("inf"), 0.0)}, False, True),
        (Outcome.RUNNING, {"q": (0.0, 0.0, 0.0, NAN)}, False, True),
        (Outcome.TIMEOUT, {"p": (NAN, 0.0, 0.0)}, False, False),
    ],
)
def test_who_failed_is_held_where_it_was(outcome, change, goes_on, diverged):
    before, after = states(**change)
    held, broken = robot.hold_if_ended(jnp.asarray(outcome, jnp.int32), before, after)
    assert bool(broken) == diverged
    zero = jax.tree.map(jnp.zeros_like, before)
    rest = dataclasses.replace(zero, p=before.p, q=before.q)
    jax.tree.map(np.testing.assert_array_equal, held, after if goes_on else rest)


@pytest.fixture(scope="module")
def by_hand():
    """Four thrusters of 0.1 N a step of 4 us and 2 W a step, from 1500 us on; one is padding."""
    steps = np.arange(201) - 100.0
    heavy = params.build_vehicle(library.load_vehicle("bluerov2_heavy"), "wu2018", 16.0)
    return dataclasses.replace(
        heavy,
        thrust_n=jnp.array(0.1 * steps),
        power_w=jnp.array(2.0 * np.abs(steps)),
        thruster_exists=jnp.array([True, True, True, False]),
        thruster_health=jnp.array([1.0, 1.0, 0.5, 1.0]),
    )


def test_thrust_and_power_of_a_signal(by_hand):
    signal = ThrusterPwm(pwm_us=jnp.array([1600.0, 1498.0, 1300.0, 1700.0]))
    thrust, power = jax.jit(partial(robot.thrust_and_power, by_hand))(signal)
    # 25, -0.5, -50 and 50 steps; the third thruster gives half, but draws as one that is sound.
    np.testing.assert_allclose(thrust, [2.5, -0.05, -2.5, 5.0], atol=1e-6)
    # What is padding draws nothing: 50 W + 1 W + 100 W.
    assert float(power) == pytest.approx(151.0, abs=1e-4)


def test_signals_beyond_the_table_are_those_of_its_ends(by_hand):
    signal = ThrusterPwm(pwm_us=jnp.array([2500.0, 0.0, 1500.0, 1500.0]))
    thrust, power = jax.jit(partial(robot.thrust_and_power, by_hand))(signal)
    np.testing.assert_allclose(thrust, [10.0, -10.0, 0.0, 0.0], atol=1e-6)
    assert float(power) == pytest.approx(400.0, abs=1e-4)


def test_a_control_step_is_all_its_physics_steps():
    assert SPEC.control_dt_s == pytest.approx(0.1)
