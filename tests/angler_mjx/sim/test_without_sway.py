"""Vehicles that cannot go sideways: each controller that takes them brings them to their goal."""

from dataclasses import replace
from functools import partial

import jax
import numpy as np
import pytest

from angler_mjx.robot.control.commands.trajectory import Trajectory
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.scenario.scenario import load_scenario
from angler_mjx.sim.engines.lanes.engine import FusedEngine
from angler_mjx.sim.fleet import Member, Variant
from angler_mjx.sim.state import Outcome
from angler_mjx.world import currents
from angler_mjx.world.currents import UniformConfig

from ..compiling import quickly
from ..robot.vehicles import made_up

SCENARIO = """schema_version = 1
name = "no_sway"
worlds = 2
engine = "fused"
goal_tolerance_m = 0.5

[time]
horizon_s = 60.0
record_hz = 2.0

[world]
preset = "open"
placement = "given"
start_m = [[-6.0, 0.0, -8.0], [6.0, 6.0, -8.0]]
goal_m = [[5.0, 4.0, -11.0], [-5.0, -5.0, -6.0]]

[[world.currents]]
type = "uniform"
velocity_mps = [0.0, 0.15, 0.0]

[controller]
name = "{controller}"

[[fleet]]
vehicle = "four.toml"

[[fleet]]
vehicle = "bluerov2"
"""


STARTS_M = np.array([[-6.0, 0, -8], [6, 6, -8], [0, 6, -9], [3, -6, -7]])
GOALS_M = np.array([[5.0, 4, -11], [-5, -5, -6], [-1, -5, -9], [2, 5, -10]])
"""Downstream, upstream, and across the current both ways."""
TOLERANCE_M, HORIZON_S = 0.5, 60.0


def test_four_thrusters_fly_along_lines_across_a_current(scenes, tmp_path):
    """In the fused engine, without obstacles or a planner, under the cascade."""
    build, _, obstacles = scenes
    four = str(made_up.write(tmp_path / "four.toml", made_up.FOUR))
    kind = Variant(vehicle=four, parameter_set="blue_gazebo", battery_v=16.0)
    member = Member(variants=(kind,), weights=(1.0,), cruise_speed_mps=0.5)
    made = build(len(STARTS_M), members=[member], config=obstacles["none"])
    terminal = np.asarray(made.equipped.control.vehicle.terminal_speed_mps)[:, 0]
    assert np.all(terminal[:, 1] == 0.0)
    assert np.all(terminal[:, 0] > 0.5)
    worlds = replace(made.worlds, environment=open_water(made.worlds.environment), path=lines())
    spec = replace(made.spec, goal_tolerance_m=TOLERANCE_M)

    @quickly
    def fly(worlds):
        steps = round(HORIZON_S / spec.control_dt_s)
        start = FusedEngine().reset(spec, made.fleet, worlds)
        run = partial(FusedEngine().segment, n_sample=1, steps_per_sample=steps)
        return run(spec, made.fleet, worlds, start)[0]

    after = jax.device_get(fly(worlds))
    assert np.all(after.tally.outcome == Outcome.REACHED), after.tally.outcome
    # Each went its way, and not much more: across, it flies at an angle to where it looks.
    way = np.linalg.norm(GOALS_M - STARTS_M, axis=1)
    assert np.all(after.tally.path_length_m[:, 0] > way - 2 * TOLERANCE_M)
    assert np.all(after.tally.path_length_m[:, 0] < 1.3 * way)


def open_water(environment):
    """Without rock, in a cube that holds all starts and goals, with a current along y."""
    count, occupied = len(STARTS_M), np.zeros_like(environment.grid.occupied)
    origin = np.tile(np.float32([-9.0, -9.0, -13.0]), (count, 1))
    cells = np.full(count, 3.0, np.float32)
    uniform = UniformConfig(velocity_mps=(0.0, 0.15, 0.0))
    current = currents.sample_current(
        currents.build_samplers((uniform,), HORIZON_S), jax.random.key(0), origin[0], -origin[0]
    )
    return replace(
        environment,
        grid=replace(environment.grid, occupied=occupied, origin_m=origin, cell_m=cells),
        floor_z_m=origin[:, 2],
        current=jax.tree.map(lambda leaf: np.stack([leaf] * count), current),
        start_m=np.float32(STARTS_M)[:, None],
        goal_m=np.float32(GOALS_M)[:, None],
    )


def lines():
    """Straight from start to goal at 0.4 m/s, [W, 1] leading."""
    ends = np.stack([STARTS_M, GOALS_M], axis=1)
    end_s = np.linalg.norm(GOALS_M - STARTS_M, axis=1) / 0.4
    times = np.stack([np.zeros_like(end_s), end_s], axis=1)
    found = np.ones((len(ends), 1), bool)
    return Trajectory(
        time_s=np.float32(times)[:, None], position_m=np.float32(ends)[:, None], found=found
    )


@pytest.mark.nightly(by="test_four_thrusters_fly_along_lines_across_a_current")
@pytest.mark.parametrize("controller", ["cascade", "los"])
def test_four_thrusters_fly_the_planners_paths(controller, tmp_path):
    made_up.write(tmp_path / "four.toml", made_up.FOUR)
    (tmp_path / "s.toml").write_text(SCENARIO.format(controller=controller))
    scenario = load_scenario(tmp_path / "s.toml")
    simulator = Simulator(scenario, tile=2)
    worlds = simulator.worlds(first=0)
    terminal = np.asarray(simulator.add_parameters(worlds).control.vehicle.terminal_speed_mps)
    assert np.all(terminal[:, 0, 1] == 0.0)
    assert np.all(terminal[:, 1] > 0.5)
    state = simulator.reset(worlds)
    steps = scenario.time.control_steps // (simulator.samples * simulator.steps_per_sample)
    for _ in range(steps):
        state, _samples = simulator.segment(worlds, state)
    outcome = np.asarray(state.tally.outcome)
    assert np.all(outcome == Outcome.REACHED), outcome
