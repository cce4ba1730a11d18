"""Vehicles whose thrusters have curves beside others in one fleet, in both engines, in float64."""

import re
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.robot.vehicles import library
from angler_mjx.sim.fleet import Member, Variant

from .flying import assert_same_flight, fly_steps

STEPS = 40
CURVE = "curve = { pwm_us = [1100, 1480, 1520, 1900], thrust_n = [-9.0, 0.0, 0.0, 14.0] }"
WEAK = 0
"""Index of the thruster with the curve."""


@pytest.fixture(scope="module")
def scene(scenes, tmp_path_factory):
    build, _, obstacles = scenes
    path = tmp_path_factory.mktemp("curves") / "weak.toml"
    text = library.locate_vehicle("bluerov2_heavy").read_text(encoding="utf-8")
    text, count = re.subn(r"(spin = -?1) \}", rf"\1, {CURVE} }}", text, count=1)
    assert count == 1
    path.write_text(text)
    kinds = [
        Variant(vehicle=vehicle, parameter_set=chosen, battery_v=16.0)
        for vehicle, chosen in (
            (str(path), "wu2018"),
            ("bluerov2_heavy", "wu2018"),
            ("bluerov2", "blue_gazebo"),
        )
    ]
    members = [Member(variants=(kind,), weights=(1.0,), cruise_speed_mps=0.5) for kind in kinds]
    with jax.enable_x64(True):
        made = build(2, members=members, config=obstacles["none"])
        environment = made.worlds.environment
        grid = replace(environment.grid, occupied=jnp.zeros_like(environment.grid.occupied))
        return replace(
            made, worlds=replace(made.worlds, environment=replace(environment, grid=grid))
        )


@pytest.fixture(scope="module")
def ends(scene, engines_by_name):
    return {name: fly_steps(engine, scene, STEPS) for name, engine in engines_by_name.items()}


def test_both_engines_fly_the_same(ends):
    assert_same_flight(ends)


def test_a_thruster_follows_its_curve(ends, scene):
    """The lag of first order, recomputed from the recorded signals and the file's numbers."""
    state, pwm = ends["fused"]
    decay = np.exp(
        -scene.spec.control_dt_s / library.load_vehicle("bluerov2_heavy").rotor.lag.time_constant_s
    )
    thrust = np.zeros(2)
    for signal in pwm[:, :, 0, WEAK]:
        settled = np.interp(signal, [1100, 1480, 1520, 1900], [-9.0, 0.0, 0.0, 14.0])
        thrust = settled + (thrust - settled) * decay
    np.testing.assert_allclose(state.vehicles.thrust[:, 0, WEAK], thrust, rtol=1e-9, atol=1e-12)
    assert np.abs(thrust).min() > 0.1
