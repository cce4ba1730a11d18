"""Vehicles that cannot go sideways: each controller that takes them brings them to their goal."""

import numpy as np
import pytest

from angler_mjx.scenario.scenario import load_scenario
from angler_mjx.sim.state import Outcome
from angler_mjx.simulator.simulator import Simulator

from ..vehicles import made_up

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


@pytest.mark.parametrize(
    "controller", ["cascade", pytest.param("los", marks=pytest.mark.nightly(by="cascade"))]
)
def test_four_thrusters_fly_across_a_current(controller, tmp_path):
    made_up.write(tmp_path / "four.toml", made_up.FOUR)
    (tmp_path / "s.toml").write_text(SCENARIO.format(controller=controller))
    scenario = load_scenario(tmp_path / "s.toml")
    simulator = Simulator(scenario, tile=2)
    worlds = simulator.worlds(first=0)
    terminal = np.asarray(worlds.control.vehicle.terminal_speed_mps)
    assert np.all(terminal[:, 0, 1] == 0.0)
    assert np.all(terminal[:, 1] > 0.5)
    state = simulator.reset(worlds)
    steps = scenario.time.control_steps // (simulator.samples * simulator.steps_per_sample)
    for _ in range(steps):
        state, _samples = simulator.segment(worlds, state)
    outcome = np.asarray(state.tally.outcome)
    assert np.all(outcome == Outcome.REACHED), outcome
