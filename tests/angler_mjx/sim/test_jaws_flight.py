"""A robot whose jaws are too weak for what they hold loses it."""

import numpy as np
import pytest

from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.scenario.scenario import load_scenario
from angler_mjx.sim.state import Outcome


@pytest.mark.nightly(by="physics/contact/test_jaws.py")
def test_a_pipe_that_is_too_heavy_for_its_jaws_is_dropped():
    """The pipe weighs 5.8 N in water, and jaws hold 2 mu 3 N, less than that."""
    simulator = Simulator(
        load_scenario(
            "carry_arms",
            worlds=1,
            tile=1,
            time={"horizon_s": 4.0, "record_hz": 1.0, "physics_dt_s": 0.01},
            task={"closing_force_n": 3.0, "break_force_n": None, "grips_m": [[0.0, 0.0, 0.0]]},
            fleet=[{"vehicle": "bluerov2_heavy_alpha5", "parameter_set": "wu2018"}],
        )
    )
    worlds = simulator.worlds()
    state = simulator.reset(worlds)
    start = np.asarray(state.obstacles.p[0, 0])
    for _ in range(simulator.segments):
        state, _ = simulator.segment(worlds, state)
    assert state.tally.outcome.tolist() == [[Outcome.DROPPED]]
    assert not state.grips.held.any()
    fallen = np.asarray(state.obstacles.p[0, 0]) - start
    assert fallen[2] < -0.1
    assert float(state.tally.grip_force_n[0, 0]) < 3.5
