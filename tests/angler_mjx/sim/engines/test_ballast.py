"""Gliders in both engines and in kernels, in a current, in float64; hulls of two bodies."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.robot.control import stages
from angler_mjx.robot.vehicles import library
from angler_mjx.sim.engines.cuda.engine import CudaEngine
from angler_mjx.sim.fleet import Member, Variant
from angler_mjx.sim.physics.step import Water

from ...compiling import quickly
from .flying import assert_same_flight, fly_steps

STEPS = 60
"""Three seconds."""
GLIDERS = [0, 1]
TANK, ALONG, ASIDE = 0, 1, 2
"""Rows of the actuators of a glider."""


@pytest.fixture(scope="module")
def split_glider(tmp_path_factory):
    """File of a glider with a hull of two bodies, which bear as one except at the surface."""
    text = library.locate_vehicle("seawing").read_text(encoding="utf-8")
    center = "center_of_buoyancy_m = [0.0, 0.0, 0.00502]\n"
    assert center in text
    bodies = ", ".join(
        f"{{ volume_m3 = 0.0318439, center_m = [{x}, {y}, 0.00502], height_m = {height} }}"
        for x, y, height in ((0.8, 0.1, 0.2), (-0.8, -0.1, 0.3))
    )
    path = tmp_path_factory.mktemp("vehicle") / "split.toml"
    path.write_text(text.replace(center, f"{center}bodies = [{bodies}]\n"), encoding="utf-8")
    return str(path)


@pytest.fixture(scope="module")
def scene(scenes, split_glider):
    build, _, obstacles = scenes
    kinds = [
        Variant(vehicle=vehicle, parameter_set=chosen, battery_v=16.0)
        for vehicle, chosen in (
            ("seawing", "zhang2013"),
            (split_glider, "zhang2013"),
        )
    ]
    members = [Member(variants=(kind,), weights=(1.0,), cruise_speed_mps=0.3) for kind in kinds]
    with jax.enable_x64(True):
        made = build(2, members=members, config=obstacles["none"])
        environment = made.worlds.environment
        grid = replace(environment.grid, occupied=jnp.zeros_like(environment.grid.occupied))
        worlds = replace(made.worlds, environment=replace(environment, grid=grid))
        stack, gains = stages.build_stack(
            stages.GLIDER_CONTROLLERS["glide"], {"glide": {"band_m": 100.0, "narrowing": 100.0}}
        )
        water = Water(density_kgpm3=1025.0)
        spec = replace(made.spec, stages=stack, gains=gains, water=water)
    return replace(made, worlds=worlds, spec=spec)


@pytest.fixture(scope="module")
def ends(scene, engines_by_name):
    return {name: fly_steps(engine, scene, STEPS) for name, engine in engines_by_name.items()}


def test_both_engines_glide_the_same(ends):
    assert_same_flight(ends)


def test_tanks_and_masses_move_at_their_rates(ends):
    state, pwm = ends["mjx"]
    values = np.asarray(state.vehicles.thrust)[:, GLIDERS]
    # Towards full from half full, at 40 ml/s, within the lag of a second at the end.
    np.testing.assert_allclose(values[..., TANK], 3.0 * 4e-5, rtol=1e-6)
    np.testing.assert_allclose(values[..., ALONG], 3.0 * 0.004, rtol=0.05)
    assert np.all(np.abs(values[..., ASIDE]) <= 0.014)
    assert np.all(np.asarray(pwm)[:, :, GLIDERS, TANK] == 1900.0)


def test_pumps_and_moving_masses_take_their_power(ends):
    """40 W for three seconds of full rate, and 4 W and 2 W by the ways of the masses."""
    state, _ = ends["mjx"]
    ways = np.abs(np.asarray(state.vehicles.thrust))[:, GLIDERS]
    energy = np.asarray(state.tally.energy_j)[:, GLIDERS]
    at_least = 40.0 / 4e-5 * ways[..., TANK] + 4.0 / 0.004 * ways[..., ALONG]
    assert np.all(energy > 0.999 * at_least)
    assert np.all(energy < 3.0 * (40.0 + 4.0 + 2.0))


def test_the_kernels_of_a_gpu_glide_the_same(scene, engines_by_name):
    """One control step at the surface with way on and the masses aside, kernels interpreted."""
    with jax.enable_x64(True):
        fused = engines_by_name["fused"]
        start = quickly(partial(fused.reset, scene.spec))(scene.fleet, scene.worlds)
        moved = jnp.array([3e-4, 0.02, -0.01])
        vehicles = replace(
            start.vehicles,
            p=start.vehicles.p.at[..., 2].set(-0.04),
            nu=start.vehicles.nu.at[..., 0].set(0.4),
            thrust=start.vehicles.thrust.at[:, jnp.array(GLIDERS), :3].set(moved),
        )
        start = jax.device_get(replace(start, vehicles=vehicles))
        ends = []
        for engine in (CudaEngine(block=2, interpret=True), fused):
            step = quickly(partial(engine.control_step, scene.spec))
            after, sample = jax.device_get(step(scene.fleet, scene.worlds, start, None))
            ends.append((after.vehicles, sample.pwm_us, after.tally.energy_j))
    np.testing.assert_allclose(ends[0][1], ends[1][1], rtol=1e-9)
    np.testing.assert_allclose(ends[0][2], ends[1][2], rtol=1e-9)
    for name in ("p", "q", "nu", "thrust"):
        ours, theirs = (getattr(end[0], name) for end in ends)
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-10)
    assert np.all(ends[0][2][:, GLIDERS] > 0.0)
