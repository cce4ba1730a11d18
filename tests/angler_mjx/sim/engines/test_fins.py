"""Torpedoes that `los` flies beside ROVs in one fleet, in both engines, in float64."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.robot.control import stages
from angler_mjx.sim.engines.cuda.engine import CudaEngine
from angler_mjx.sim.fleet import Member, Variant

from ...compiling import quickly
from .flying import assert_same_flight, fly_steps

STEPS = 60
"""Three seconds."""


@pytest.fixture(scope="module")
def scene(scenes):
    build, _, obstacles = scenes
    kinds = [
        Variant(vehicle=vehicle, parameter_set=chosen, battery_v=16.0)
        for vehicle, chosen in (
            ("remus100", "prestero2001"),
            ("bluerov2_heavy", "wu2018"),
            ("remus100", "prestero2001"),
        )
    ]
    members = [Member(variants=(kind,), weights=(1.0,), cruise_speed_mps=1.5) for kind in kinds]
    with jax.enable_x64(True):
        made = build(2, members=members, config=obstacles["none"])
        environment = made.worlds.environment
        grid = replace(environment.grid, occupied=jnp.zeros_like(environment.grid.occupied))
        worlds = replace(made.worlds, environment=replace(environment, grid=grid))
        stack, gains = stages.build_stack(stages.CONTROLLERS["los"], {})
        spec = replace(made.spec, stages=stack, gains=gains)
    return replace(made, worlds=worlds, spec=spec)


@pytest.fixture(scope="module")
def ends(scene, engines_by_name):
    return {name: fly_steps(engine, scene, STEPS) for name, engine in engines_by_name.items()}


def test_both_engines_fly_the_same(ends):
    assert_same_flight(ends)


def test_fins_move_within_their_limits_and_rovs_have_none(ends):
    state, pwm = ends["mjx"]
    # A fleet's rows are those of the Heavy, eight; torpedoes have a propeller and two fins.
    deflection = np.asarray(state.vehicles.thrust)[:, [0, 2], 1:3]
    assert np.all(np.abs(deflection) <= 0.26)
    assert np.ptp(np.asarray(pwm)[:, :, [0, 2], 1:3]) > 100.0
    np.testing.assert_array_equal(np.asarray(pwm)[:, :, [0, 2], 3:], 1500.0)
    assert np.all(np.asarray(state.vehicles.nu)[:, [0, 2], 0] > 0.3)


def test_the_kernels_of_a_gpu_fly_the_same(scene, engines_by_name):
    """One control step with way on, of kernels that are interpreted."""
    with jax.enable_x64(True):
        fused = engines_by_name["fused"]
        start = quickly(partial(fused.reset, scene.spec))(scene.fleet, scene.worlds)
        vehicles = replace(start.vehicles, nu=start.vehicles.nu.at[..., 0].set(1.2))
        start = jax.device_get(replace(start, vehicles=vehicles))
        ends = []
        for engine in (CudaEngine(block=2, interpret=True), fused):
            step = quickly(partial(engine.control_step, scene.spec))
            after, sample = jax.device_get(step(scene.fleet, scene.worlds, start, None))
            ends.append((after.vehicles, sample.pwm_us))
    np.testing.assert_allclose(ends[0][1], ends[1][1], rtol=1e-9)
    for name in ("p", "q", "nu", "thrust"):
        ours, theirs = (getattr(end[0], name) for end in ends)
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-10)
    assert np.abs(ends[0][0].thrust[:, [0, 2], 1:3]).max() > 1e-3
