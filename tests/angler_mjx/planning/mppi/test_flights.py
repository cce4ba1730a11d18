"""Fleets flown by path integral control, named by a scenario file."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

import angler_mjx as angler
from angler_mjx.errors import ConfigError
from angler_mjx.runs.simulator import scenario_policy
from angler_mjx.sim.information import Information
from angler_mjx.sim.state import Outcome

from ...robot.vehicles import made_up

SCENARIO = """
name = "meeting"
engine = "fused"
worlds = 1
tile = 1
seed = 1

[time]
horizon_s = 20.0
record_hz = 5.0

[world]
preset = "open"
shape = [8, 8, 4]
depth_m = 2.0
placement = "given"
start_m = [[-3.0, 0.0, -5.0], [3.0, 0.0, -5.0]]
goal_m = [[3.0, 0.0, -5.0], [-3.0, 0.0, -5.0]]

[[world.currents]]
type = "uniform"
velocity_mps = [0.0, 0.25, 0.0]

[[fleet]]
vehicle = "bluerov2_heavy"
count = 2

[policy]
name = "mppi"

[policy.information]
current = "predicted"

[policy.mppi]
output = "OUTPUT"
hz = 5
samples = 64
dt_s = 0.2
"""


@pytest.fixture(scope="module")
def load(tmp_path_factory):
    folder = tmp_path_factory.mktemp("mppi")

    def loaded(output="twist", **changes):
        file = folder / f"{output}.toml"
        file.write_text(SCENARIO.replace("OUTPUT", output))
        return angler.load_scenario(file, **changes)

    return loaded


def fly(simulator, worlds):
    """The last state, and places of robots and obstacles [samples, world, body, 3]."""
    state, robots, obstacles = simulator.reset(worlds), [], []
    for _ in range(simulator.segments):
        state, seen = simulator.segment(worlds, state)
        robots.append(np.moveaxis(np.asarray(seen.p), 1, 0))
        obstacles.append(np.moveaxis(np.asarray(seen.obstacle_p), 1, 0))
    return state, np.concatenate(robots), np.concatenate(obstacles)


DAILY = "test_two_that_meet_head_on_pass_and_hold_their_goals_in_a_current[twist]"


@pytest.mark.parametrize(
    "output", ["twist", pytest.param("wrench", marks=pytest.mark.nightly(by=DAILY))]
)
def test_two_that_meet_head_on_pass_and_hold_their_goals_in_a_current(load, output):
    """Neither has a plan: the policy needs the goal alone."""
    simulator = angler.Simulator(load(output))
    worlds = simulator.worlds()
    state, robots, _ = fly(simulator, without_plans(worlds))
    assert np.all(np.asarray(state.tally.outcome) == Outcome.REACHED)
    assert np.asarray(state.tally.min_separation_m).min() > 0.05
    radii = np.asarray(simulator.add_parameters(worlds).control.vehicle.radius_m)[0]
    apart = np.linalg.norm(robots[:, :, 0] - robots[:, :, 1], axis=-1)
    assert apart.min() > radii.sum()
    goal = np.asarray(worlds.environment.goal_m)
    assert np.linalg.norm(robots[-10:] - goal, axis=-1).max() < 0.3


BALL = {
    "type": "sphere",
    "radius_m": 0.7,
    "position_m": [-1.0, -1.2, -5.0],
    "motion": {"type": "drift"},
}
"""It drifts in the current, and is on the second robot's way when that has come round the wall."""


@pytest.mark.nightly(by="test_sampling.py::test_a_ball_that_crosses_its_way_is_let_pass")
@pytest.mark.parametrize(
    ("level", "second"), [("predicted", Outcome.REACHED), ("nothing", Outcome.COLLISION_DYNAMIC)]
)
def test_they_go_round_rock_and_past_a_ball_that_they_know_of(load, level, second):
    changes = {
        "time": {"horizon_s": 40.0},
        "world": {"obstacles": {"explicit": [BALL]}},
        "policy": {"information": {"obstacles": level, "current": "predicted"}},
    }
    simulator = angler.Simulator(load(**changes))
    worlds = simulator.worlds()
    rock = np.zeros(np.shape(worlds.environment.grid.occupied), bool)
    rock[:, 4, :6] = True
    grid = replace(worlds.environment.grid, occupied=jnp.asarray(rock))
    walled = replace(worlds, environment=replace(worlds.environment, grid=grid))
    state, robots, balls = fly(simulator, without_plans(walled))
    assert np.asarray(state.tally.outcome)[0].tolist() == [Outcome.REACHED, second]
    assert np.abs(balls[-1] - balls[0]).max() > 1.0
    # The way is open above y = 3 m alone.
    assert robots[:, 0, :, 1].max(axis=0).min() > 3.0


def without_plans(worlds):
    """Plans that hold the start, as where none was found."""
    path, start = worlds.path, worlds.environment.start_m
    held = np.repeat(np.asarray(start)[:, :, None], path.position_m.shape[2], axis=2)
    none = np.zeros(np.shape(path.found), bool)
    return replace(
        worlds, path=replace(path, position_m=jnp.asarray(held), found=jnp.asarray(none))
    )


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"policy": {"name": "mpc"}}, r"policy\.name"),
        ({"policy": {"mppi": {"sample": 3}}}, r"sample = 3: unknown key"),
        ({"policy": {"mppi": {"hz": 3.0}}}, r"policy\.mppi\.hz = 3"),
        ({"policy": {"mppi": {"dt_s": 0.7}}}, r"horizon_s / dt_s .*whole"),
        ({"policy": {"mppi": {"dt_s": 1.5}}}, r"knots = 8: samples have 2 steps"),
        ({"policy": {"mppi": {"weights": {"far": 1.0}}}}, r"'far': no such weight; there is end"),
        ({"policy": {"mppi": {"weights": {"noise": 0.0}}}}, r"noise = 0: give a number above 0"),
        ({"planner": {"replan_hz": 1.0}}, r"planner\.replan_hz commands the robots already"),
        ({"execution": {"order": "kept"}}, r'execution\.order .*= "kept" commands'),
        (
            {"controller": {"name": "ardusub"}, "policy": {"mppi": {"output": "wrench"}}},
            r"policy\.mppi\.output = 'wrench': no stage of controller 'ardusub'",
        ),
    ],
)
def test_what_cannot_be_flown_is_refused_by_its_key(load, changes, said):
    with pytest.raises(ConfigError, match=said):
        load(**changes)


def test_wrenches_are_refused_to_what_cannot_push_to_the_side(load, tmp_path):
    made_up.write(tmp_path / "four.toml", made_up.FOUR)
    fleet = [{"vehicle": "bluerov2_heavy"}, {"vehicle": str(tmp_path / "four.toml")}]
    load("twist", fleet=fleet)
    with pytest.raises(
        ConfigError, match=r"fleet\[1\], vehicle 'made_up', has no sway; take output"
    ):
        load("wrench", fleet=fleet)


@pytest.mark.nightly(by="test_wrenches_are_refused_to_what_cannot_push_to_the_side")
def test_what_has_no_sway_flies_by_its_bow(load, tmp_path):
    made_up.write(tmp_path / "four.toml", made_up.FOUR)
    fleet = [{"vehicle": str(tmp_path / "four.toml"), "count": 2}]
    still = {"currents": []}
    simulator = angler.Simulator(load(fleet=fleet, world=still, time={"horizon_s": 40.0}))
    state, _, _ = fly(simulator, simulator.worlds())
    assert np.all(np.asarray(state.tally.outcome) == Outcome.REACHED)


def test_a_bad_value_of_a_file_is_told_by_file_key_and_value(tmp_path):
    file = tmp_path / "bad.toml"
    file.write_text(SCENARIO.replace("OUTPUT", "pose").replace("samples = 64", "samples = 1"))
    with pytest.raises(ConfigError) as refused:
        angler.load_scenario(file)
    said = str(refused.value)
    assert said.count(str(file)) == 1
    assert "policy.mppi.samples = 1: " in said
    assert "policy.mppi.output = 'pose': " in said


def test_a_policy_beside_the_scenarios_own_is_refused(load):
    scenario = load()
    made = scenario_policy.resolve_policy(scenario, None)
    assert (made.period, made.samples, made.steps, made.knots) == (4, 64, 15, 8)
    with pytest.raises(ConfigError, match=r'policy\.name = "mppi" commands the robots'):
        angler.Simulator(scenario, policy=made)


def test_what_it_knows_is_what_the_planner_may_unless_it_is_said(load):
    assert scenario_policy.resolve_policy(load(), None).information == Information(
        current="predicted"
    )
    told = load(policy={"information": None}, planner={"information": {"obstacles": "observed"}})
    assert scenario_policy.resolve_policy(told, None).information == Information(
        obstacles="observed"
    )
