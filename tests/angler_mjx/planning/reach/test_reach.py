"""End effectors at the goals: the policy, its settings, and flights in a current."""

from dataclasses import replace
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_kernels import quaternion
from angler_mjx.errors import ConfigError
from angler_mjx.planning.reach.policy import Reach
from angler_mjx.robot.control.commands import BodyTwist, PoseTarget
from angler_mjx.robot.control.commands.whole_body import EndEffectorTarget
from angler_mjx.robot.vehicles.link_motion import locate_end_effector
from angler_mjx.runs.session.batch_session import BatchSession
from angler_mjx.runs.session.online_policy import OnlineFlyer
from angler_mjx.runs.session.session_flight import fly_session
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.scenario.scenario import Scenario, load_scenario
from angler_mjx.sim.state import Outcome

OPEN = {
    "name": "reach",
    "engine": "mjx",
    "worlds": 1,
    "tile": 1,
    "goal_tolerance_m": 0.02,
    "time": {"horizon_s": 40.0, "record_hz": 0.0},
    "world": {
        "preset": "open",
        "placement": "given",
        "start_m": [[-4.0, -6.0, -5.0]],
        "goal_m": [[-1.0, -6.0, -4.5]],
        "currents": [{"type": "uniform", "velocity_mps": [-0.2, 0.2, 0.1]}],
    },
    "task": {"type": "goal", "reached_by": "end_effector"},
    "controller": {"name": "arm"},
    "fleet": [{"vehicle": "bluerov2_heavy_alpha5", "parameter_set": "wu2018"}],
}


def inputs_at(distance_m):
    p = jnp.array([[0.0, 0.0, -5.0]])
    return SimpleNamespace(
        belief=SimpleNamespace(p=p, q=jnp.array([[1.0, 0.0, 0.0, 0.0]])),
        goal_m=p + jnp.array([[distance_m, 0.0, 0.0]]),
        path="plan",
    )


def test_a_robot_follows_its_plan_until_it_is_near_and_again_when_it_drifted_off():
    policy = Reach(begin_m=1.0, stages=3)
    carry = policy.reset(inputs_at(5.0), None)
    seen = []
    for distance in (5.0, 1.1, 0.9, 1.4, 0.2, 1.6, 1.2):
        carry, command = policy.act(carry, inputs_at(distance), None, 0)
        seen.append((int(command.which[0]), int(command.fresh[0])))
    assert seen == [(0, 0), (0, 0), (1, 3), (1, 0), (1, 0), (0, 0), (0, 0)]
    plan, target = command.commands
    assert plan == "plan"
    assert isinstance(target, EndEffectorTarget)
    np.testing.assert_array_equal(target.position_m, inputs_at(1.2).goal_m)
    assert not bool(target.is_oriented[0])
    np.testing.assert_array_equal(target.q, [[1.0, 0.0, 0.0, 0.0]])
    for name in ("velocity_mps", "angular_velocity_radps"):
        np.testing.assert_array_equal(getattr(target, name), np.zeros((1, 3)))


def test_a_robot_begins_with_its_plan():
    """Also where it would go on reaching, had it begun to."""
    policy = Reach(begin_m=1.0, stages=3)
    carry, command = policy.act(policy.reset(inputs_at(1.1), None), inputs_at(1.1), None, 0)
    assert not bool(carry.is_reaching[0])
    assert int(command.which[0]) == 0


def test_the_task_brings_its_policy():
    scenario = Scenario.model_validate(OPEN)
    assert scenario.policy.name == "reach"
    assert scenario.sim_spec().by_end_effector
    center = OPEN | {"task": {"type": "goal"}}
    assert Scenario.model_validate(center).policy.name == "none"
    assert Scenario.model_validate(center).digest() != scenario.digest()
    # A policy of one's own may place the end effectors.
    own = Scenario.model_validate(OPEN | {"policy": {"name": "none"}})
    assert own.sim_spec().by_end_effector
    assert not own.flown


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"controller": {"name": "cascade"}},
            'policy.name = "reach": no stage of controller .* takes an EndEffectorTarget; take',
        ),
        (
            {"fleet": [{"vehicle": "bluerov2_heavy"}]},
            r"fleet\[0\], vehicle 'bluerov2_heavy', has no table \[end_effector\]",
        ),
        ({"engine": "fused"}, r'has joints; engine = "fused" flies rigid vehicles only'),
        ({"policy": {"reach": {"begin_m": 0.0}}}, "policy.reach.begin_m"),
        ({"execution": {"order": "kept"}}, "policy.name = 'reach': execution.order"),
        ({"task": {"type": "goal", "reached_by": "nose"}}, "task.goal.reached_by"),
    ],
)
def test_what_cannot_reach_is_refused_by_name(change, message):
    with pytest.raises(ValueError, match=message):
        Scenario.model_validate(OPEN | change)


def test_an_end_effector_comes_to_its_goal_in_a_current():
    """And stays within 2 cm of it; the base is an arm's length away."""
    simulator = Simulator(Scenario.model_validate(OPEN))
    worlds = simulator.worlds()
    state = simulator.reset(worlds)
    for _ in range(simulator.segments):
        state, _, _ = simulator.advance(worlds, state)
    assert state.tally.outcome[0, 0] == Outcome.REACHED
    assert 5.0 < float(state.tally.end_time_s[0, 0]) < 35.0
    vehicles = jax.tree.map(lambda leaf: leaf[0, 0], state.vehicles)
    links = jax.tree.map(lambda leaf: leaf[0], simulator.fleet.control.vehicle.links)
    tip = locate_end_effector(links, vehicles.joints.position)
    goal = worlds.environment.goal_m[0, 0]
    position = vehicles.p + quaternion.rotate(vehicles.q, tip.position)
    assert float(jnp.linalg.norm(position - goal)) < 0.02
    assert float(jnp.linalg.norm(vehicles.p - goal)) > 0.3
    assert int(state.carry.joints_clipped[0, 0]) == 0


def test_a_session_flies_the_policy_step_by_step(session):
    """Its plan is flown until the goal is near; then targets of the end effector come."""
    kinds = []
    flight = fly_session(
        session, 40.0, watch=lambda observation: kinds.append(observation.status[0].command)
    )
    assert flight.last.status[0].outcome is Outcome.REACHED
    assert not flight.last.status[0].refused
    assert list(dict.fromkeys(kinds)) == ["plan", "EndEffectorTarget"]
    assert 5.0 < flight.last.time_s < 35.0


def test_a_robot_that_drifted_off_is_led_back_to_its_plan(session, monkeypatch):
    """Sessions hold the plan: it is not commanded, but resumed where another command came."""
    flyer = OnlineFlyer(session)
    resumed = []
    monkeypatch.setattr(session, "resume_plan", resumed.append)
    observation = session.observe()
    assert flyer.commands(observation) == {}
    assert resumed == []
    (status,) = observation.status
    drifted = replace(observation, status=(replace(status, command="EndEffectorTarget"),))
    assert flyer.commands(drifted) == {}
    assert resumed == [0]


def test_a_robot_without_a_way_back_holds_says_so_once_and_searches_each_second(
    session, monkeypatch
):
    """Then it is led back, once there is a way."""
    flyer = OnlineFlyer(session)
    resume_plan, searched_s = session.resume_plan, []

    def find_nothing(robot):
        searched_s.append(observation.time_s)
        raise ConfigError("robot_0: no way back to its plan was found")

    monkeypatch.setattr(session, "resume_plan", find_nothing)
    driven = BodyTwist(nu=jnp.array([0.0, 0.2, 0.0, 0.0, 0.0, 0.0]))
    for _ in range(10):
        observation = session.step({0: driven})
    held_m, sent = observation.estimate.p[0], []

    def fly(steps):
        nonlocal observation
        for _ in range(steps):
            sent.append(flyer.commands(observation))
            observation = session.step(sent[-1])

    with pytest.warns(RuntimeWarning, match="robot_0: no way back") as warned:
        fly(50)
    assert len(warned) == 1
    assert "holds its position, and searches again every 1 s" in str(warned[0].message)
    np.testing.assert_allclose(searched_s, [0.5, 1.5, 2.5])
    assert [type(command) for command in sent[0].values()] == [PoseTarget]
    assert not any(sent[1:])
    # The current of 0.3 m/s would carry it by 0.75 m.
    assert np.linalg.norm(observation.estimate.p[0] - held_m) < 0.25
    monkeypatch.setattr(session, "resume_plan", resume_plan)
    fly(21)
    assert observation.status[0].command == "plan"


@pytest.fixture(scope="module")
def opened():
    return BatchSession(Scenario.model_validate(OPEN))


@pytest.fixture
def session(opened):
    opened.reset()
    return opened


def test_a_command_to_the_end_effector_needs_links():
    scenario = load_scenario("open_water_current", engine="mjx", worlds=1, tile=1)
    simulator = Simulator(scenario.model_copy(update={"controller": _arm_controller()}))
    worlds = simulator.worlds()
    state = simulator.reset(worlds)
    goal = worlds.environment.goal_m
    target = EndEffectorTarget(
        position_m=goal,
        q=jnp.zeros((*goal.shape[:2], 4)),
        velocity_mps=jnp.zeros_like(goal),
        angular_velocity_radps=jnp.zeros_like(goal),
        is_oriented=jnp.zeros(goal.shape[:2], bool),
    )
    with pytest.raises(ConfigError, match="EndEffectorTarget: no robot of the fleet has links"):
        simulator.step(worlds, state, target)


def _arm_controller():
    return Scenario.model_validate(OPEN).controller
