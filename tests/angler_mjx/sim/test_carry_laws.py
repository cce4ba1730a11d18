"""Flights by the laws of carriers: internal force at rest, and a follower without a plan."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from angler_mjx.robot.control.commands import PoseTarget
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.scenario.scenario import load_scenario
from angler_mjx.sim.state import Outcome

STIFFNESS, MISFIT = 120.0, 0.16


def load(stages, **gains):
    """Return a simulator of one world of carry_pipe."""
    controller = {"stages": ["follow", *stages, "velocity", "cargo_wrench", "pseudo_inverse"]}
    time = {"horizon_s": 60.0, "record_hz": 1.0, "physics_dt_s": 0.01}
    return Simulator(
        load_scenario(
            "carry_pipe", worlds=1, tile=1, time=time, controller=controller | {"gains": gains}
        )
    )


def pull_apart(simulator):
    """Return the forces [R, 3] on the robots at rest, in W, whose targets are too far apart."""
    worlds = simulator.worlds()
    state, start = simulator.reset(worlds), worlds.environment
    apart = jnp.asarray([[-0.5, 0.0, 0.0], [0.5, 0.0, 0.0]], jnp.float32) * MISFIT
    target = PoseTarget(
        position_m=start.start_m + apart,
        velocity_mps=jnp.zeros_like(start.start_m),
        yaw_rad=start.start_yaw_rad,
    )
    for _ in range(simulator.segments):
        state, _ = simulator.segment(worlds, state, target)
    assert np.all(np.asarray(state.tally.outcome) == Outcome.RUNNING)
    assert np.abs(state.vehicles.nu).max() < 0.01
    turn = Rotation.from_quat(np.asarray(state.vehicles.q[0]), scalar_first=True)
    return turn.apply(np.asarray(state.grips.wrench[0, :, :3]))


def test_robots_that_pull_at_each_other_settle_at_half_the_misfit_times_the_stiffness():
    yielding = pull_apart(load(["admittance", "pose"], admittance={"stiffness_n_per_m": STIFFNESS}))
    want = 0.5 * STIFFNESS * MISFIT
    np.testing.assert_allclose(yielding[:, 0], [want, -want], rtol=0.04)


def test_without_admittance_they_pull_until_their_integrals_are_bounded():
    force = pull_apart(load(["pose"]))
    assert force[0, 0] > 3.0 * 0.5 * STIFFNESS * MISFIT
    assert force[1, 0] < -3.0 * 0.5 * STIFFNESS * MISFIT


@pytest.mark.parametrize("leader", [0, 1])
def test_a_follower_without_a_plan_carries_as_far_as_the_leader_goes(leader):
    """The pipe goes 7 m and turns by a quarter; the follower's plan is to stay where it is."""
    simulator = load(["pose", "leader_follower"])
    simulator = Simulator(
        simulator.scenario.model_copy(
            update={
                "controller": simulator.scenario.controller.model_copy(update={"leader": leader})
            }
        )
    )
    worlds = simulator.worlds()
    path, other = worlds.path, 1 - leader
    position = np.array(path.position)
    way_m = np.linalg.norm(position[0, leader, -1, :3] - position[0, leader, 0, :3])
    assert way_m > 5.0
    position[0, other] = position[0, other, :1]
    velocity = np.array(path.velocity)
    velocity[0, other] = 0.0
    path = replace(path, position=jnp.asarray(position), velocity=jnp.asarray(velocity))
    worlds = replace(worlds, path=path)
    state = simulator.reset(worlds)
    for _ in range(simulator.segments):
        state, _, _ = simulator.advance(worlds, state)
    tally = jax.tree.map(np.asarray, state.tally)
    assert tally.outcome.tolist() == [[Outcome.REACHED] * 2]
    assert np.all(tally.end_time_s < 50.0)
    assert np.all(tally.path_length_m > 4.0)
    assert np.all(tally.internal_force_n < 10.0)


def test_a_measured_force_holds_the_pipe_level_in_a_current_that_no_controller_knows():
    """At 0.5 m/s `cargo_wrench` arrives in 6 of 100 worlds, though it knows the current."""
    simulator = Simulator(
        load_scenario(
            "carry_pipe",
            worlds=1,
            tile=1,
            time={"horizon_s": 45.0, "record_hz": 1.0, "physics_dt_s": 0.01},
            world={"currents": [{"type": "uniform", "velocity_mps": [0.5, 0.0, 0.0]}]},
        )
    )
    assert not any(stage.wants_flow for stage in simulator.spec.stages)
    worlds = simulator.worlds()
    state = simulator.reset(worlds)
    for _ in range(simulator.segments):
        state, _ = simulator.segment(worlds, state)
    np.testing.assert_array_equal(state.tally.outcome, Outcome.REACHED)
    tilt = Rotation.from_quat(np.asarray(state.vehicles.q[0]), scalar_first=True).apply([0, 0, 1])
    assert tilt[:, 2].min() > np.cos(np.radians(12.0))
