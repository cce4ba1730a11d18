"""A simulator that is given a world with edits: rock is met, parameters and signals are refused.

And a run of it, which stores no trajectories.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_kernels.clearance import cell_neighbours
from angler_mjx.cli.main import main
from angler_mjx.errors import ConfigError
from angler_mjx.robot.control.commands import BodyTwist, ThrusterPwm
from angler_mjx.runs.rollout import rollout
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.scenario.scenario import load_scenario
from angler_mjx.sim.state import Outcome, Touched, World

SCENARIO = """
schema_version = 1
name = "edited"
engine = "fused"
kernels = "xla"
worlds = 2
seed = 3
tile = 1

[time]
horizon_s = 60.0
record_hz = 0.0

[world]
preset = "open"
placement = "random"

[[fleet]]
vehicle = "bluerov2_heavy"
parameter_set = "wu2018"
count = 2
"""


@pytest.fixture(scope="module")
def simulator(tmp_path_factory):
    path = tmp_path_factory.mktemp("edited") / "edited.toml"
    path.write_text(SCENARIO)
    simulator = Simulator(load_scenario(path))
    simulator.compile()
    return simulator


@pytest.fixture(scope="module")
def worlds(simulator):
    return simulator.worlds()


def test_a_simulator_may_be_traced(simulator, worlds):
    """By programs that count, differentiate or repeat it, whatever was compiled before."""
    state = simulator.reset(worlds)
    after = jax.eval_shape(lambda x: simulator.advance(x, simulator.reset(x)), worlds)
    assert after[0].vehicles.p.shape == state.vehicles.p.shape
    assert after[2].shape == (1,)
    after, _ = jax.eval_shape(simulator.step, worlds, state)
    assert after.vehicles.p.shape == state.vehicles.p.shape
    same = jax.jit(lambda: simulator.reset(worlds).vehicles.p)()
    np.testing.assert_array_equal(same, state.vehicles.p)


def fly(simulator, worlds):
    """The state after the first rock, or the horizon."""
    state = simulator.reset(worlds)
    for _ in range(simulator.segments):
        state, _ = simulator.segment(worlds, state)
    return state.tally


def test_rock_that_is_put_into_a_world_is_met(simulator, worlds):
    open_water = fly(simulator, worlds)
    assert np.all(open_water.outcome == Outcome.REACHED)
    environment = worlds.environment
    start, goal = (np.asarray(x) for x in (environment.start_m, environment.goal_m))
    grid = environment.grid
    lo, cell = np.asarray(grid.origin_m)[:, None], np.asarray(grid.cell_m)[:, None, None]
    # Every cell of a robot's way is rock but those around its start.
    share = np.linspace(0.0, 1.0, 200)[:, None, None, None]
    line_m = start + share * (goal - start)
    far = np.linalg.norm(line_m - start, axis=-1) > 4.0
    index = np.floor((line_m - lo) / cell).astype(int)
    occupied = np.asarray(grid.occupied).copy()
    at = index[:, 0][far[:, 0]]
    occupied[(0, *at.T)] = True
    rock = replace(grid, occupied=jnp.asarray(occupied))
    walled = replace(worlds, environment=replace(environment, grid=rock))
    tally = fly(simulator, walled)
    assert np.all(tally.outcome == Outcome.COLLISION_STATIC)
    assert np.all(tally.touched == Touched.CELL)


def test_a_plan_is_flown_on_its_last_approach_alone(simulator, worlds):
    """A closed plan of 8 m, and one of 9 m that passes its goal after 3 m and turns back at 6 m.

    Before, both ended at the first pass: after 0.05 s, and after 6 s.
    """
    environment, path = worlds.environment, worlds.path
    start, goal = (np.asarray(x)[0] for x in (environment.start_m, environment.goal_m))
    along = (goal - start) / np.linalg.norm(goal - start, axis=-1, keepdims=True)
    time, point = np.array(path.time_s), np.array(path.position_m)
    goals = np.array(environment.goal_m)
    for robot, (first_m, turn_m, end_m) in enumerate(((2.0, 4.0, 0.0), (3.0, 6.0, 3.0))):
        at_m = np.array([0.0, first_m, turn_m, end_m])
        at_s = np.cumsum(np.abs(np.diff(at_m, prepend=0.0))) / 0.5
        time[0, robot], time[0, robot, :4] = at_s[-1], at_s
        rows = start[robot] + at_m[:, None] * along[robot]
        point[0, robot], point[0, robot, :4] = rows[-1], rows
        goals[0, robot] = rows[-1]
    edited = replace(
        worlds,
        environment=replace(environment, goal_m=jnp.asarray(goals)),
        path=replace(path, time_s=jnp.asarray(time), position_m=jnp.asarray(point)),
    )
    tally = fly(simulator, edited)
    assert np.all(tally.outcome == Outcome.REACHED)
    assert np.all(tally.passed_early)
    # Less the tolerance, and what is cut at the turn.
    np.testing.assert_array_less([[8.0 - 0.3 - 1.0, 9.0 - 0.3 - 1.0]], tally.path_length_m)
    np.testing.assert_array_less([[14.0, 16.0]], tally.end_time_s)
    assert not np.any(fly(simulator, worlds).passed_early)


def test_a_segment_may_begin_where_a_single_step_ended(simulator, worlds):
    before, _ = simulator.step(worlds, simulator.reset(worlds))
    before, _ = simulator.segment(worlds, before)
    after, _ = simulator.segment(worlds, simulator.reset(worlds))
    after, _ = simulator.step(worlds, after)
    assert before.step.tolist() == after.step.tolist() == [simulator.segment_steps + 1]
    # Two programs of the same arithmetic: an ulp or two of 18 m in 100 steps of single precision.
    np.testing.assert_allclose(before.vehicles.p, after.vehicles.p, rtol=0.0, atol=2e-5)


def test_variants_are_refused_by_all_that_take_a_world(simulator, worlds):
    other = replace(worlds, variant=worlds.variant + 1)
    state = simulator.reset(worlds)
    for enter in (
        lambda: simulator.reset(other),
        lambda: simulator.step(other, state),
        lambda: simulator.segment(other, state),
        lambda: simulator.advance(other, state),
        lambda: simulator.adopt(other),
        lambda: simulator.add_parameters(other),
    ):
        with pytest.raises(ConfigError, match=r"World\.variant of world 0, robot 0 is 1"):
            enter()


def test_parameters_are_those_of_the_fleet(simulator, worlds):
    equipped = simulator.add_parameters(worlds)
    mass = simulator.fleet.control.vehicle.mass_kg
    np.testing.assert_array_equal(equipped.control.vehicle.mass_kg, mass[worlds.variant])
    np.testing.assert_array_equal(equipped.control.cruise_speed_mps, worlds.cruise_speed_mps)
    assert equipped.control.vehicle.mass_kg.sharding == worlds.variant.sharding
    adopted = simulator.adopt(equipped)
    assert type(adopted) is World
    np.testing.assert_array_equal(
        simulator.reset(adopted).vehicles.p, simulator.reset(worlds).vehicles.p
    )


def test_cells_are_packed_once_for_each_grid(simulator, worlds):
    packed = simulator._pack_cells(worlds)
    environment = worlds.environment
    moved = replace(worlds, environment=replace(environment, goal_m=environment.goal_m + 1.0))
    assert simulator._pack_cells(moved) is packed
    grid = environment.grid
    walls = replace(grid, occupied=grid.occupied.at[:, 5].set(True))
    other = replace(worlds, environment=replace(environment, grid=walls))
    expected = jax.vmap(cell_neighbours)(walls.occupied)
    np.testing.assert_array_equal(simulator._pack_cells(other), expected)
    # Arrays that can be written to are packed each time.
    host = jax.tree.map(np.array, worlds)
    simulator._pack_cells(host)
    host.environment.grid.occupied[:] |= np.asarray(walls.occupied)
    np.testing.assert_array_equal(simulator._pack_cells(host), expected)


def test_commands_are_refused_before_they_enter(simulator, worlds):
    state = simulator.reset(worlds)
    for bad, message in (
        (BodyTwist(nu=np.zeros((1, 2, 3))), r"nu has the shape \[1, 2, 3\]: must be \[1, 2, 6\]"),
        (ThrusterPwm(pwm_us=np.zeros((1, 2, 6))), r"\[1, 2, 6\]: must be \[1, 2, 8\]"),
        (ThrusterPwm(pwm_us=np.full((1, 2, 8), 1e9)), "thruster 0 is 1e\\+09 us: must be 1100"),
    ):
        for enter in (simulator.step, simulator.segment):
            with pytest.raises(ConfigError, match=message):
                enter(worlds, state, bad)


@pytest.mark.parametrize("name", ["fleet", "spec"])
def test_what_programs_hold_is_not_set_later(simulator, name):
    with pytest.raises(AttributeError):
        setattr(simulator, name, None)


def test_a_run_that_stores_no_trajectories_has_rows_and_figures(simulator, tmp_path, capsys):
    run = rollout(simulator.scenario, out=tmp_path / "run", simulator=simulator)
    assert run.summary["complete"]
    assert run.summary["worlds_done"] == 2
    assert run.episodes["outcome"].to_pylist() == ["reached"] * 4
    with pytest.raises(ConfigError, match="stored no trajectories"):
        _ = run.trajectories
    main(["figures", str(run.path)])
    assert "no maps and no replay" in capsys.readouterr().err
    figures = sorted(path.name for path in (run.path / "figures").iterdir())
    assert figures == ["distances.png", "outcomes.png", "time_to_goal.png"]
