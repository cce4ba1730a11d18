"""Currents of an ocean model's file, by depth and by tides: one flight in all three engines."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_experiments.ocean import headland
from angler_mjx.robot.control.commands import ThrusterPwm
from angler_mjx.sim.engines.base import by_name
from angler_mjx.sim.engines.cuda.engine import CudaEngine
from angler_mjx.sim.engines.lanes.engine import FusedEngine
from angler_mjx.world import currents
from angler_mjx.world.currents import DepthProfileConfig, GridConfig, TideConfig
from angler_mjx.world.currents.sea import ConstituentConfig
from angler_mjx.world.environment import region_corners

from ...compiling import quickly

pytestmark = pytest.mark.usefixtures("compiled_sources")  # kernels run here, as C

WORLDS, STEPS = 2, 2


@pytest.fixture(scope="module")
def scene(scenes, tmp_path_factory):
    """Single robots in worlds of currents alone, each at a place of its own in one file."""
    build, members, obstacles = scenes
    made = build(WORLDS, members=members("bluerov2"), config=obstacles["none"])
    path = headland.write_dataset(tmp_path_factory.mktemp("ocean") / "headland.nc")
    configs = (
        # Ten times as fast as the file, so that it is seen in a moment; over a few of its cells.
        GridConfig(file=str(path), scale={"space": 0.01, "speed": 4.0, "time": 0.01}),
        DepthProfileConfig(depth_m=(0.0, 4.0, 8.0, 12.0), speed_mps=(0.1, 0.3)),
        TideConfig(constituents=(ConstituentConfig(name="M2", major_mps=0.3, minor_mps=0.1),)),
    )
    lo, hi = region_corners(jax.tree.map(lambda leaf: leaf[0], made.worlds.environment))
    samplers = currents.build_samplers(configs, 10.0)
    draw = partial(currents.sample_current, samplers, region_lo=lo, region_hi=hi)
    current = quickly(jax.vmap(lambda key: draw(key=key)))(
        jax.random.split(jax.random.key(2), WORLDS)
    )
    environment = replace(made.worlds.environment, current=current)
    return replace(made, worlds=replace(made.worlds, environment=environment))


@pytest.fixture(scope="module")
def begun(scene):
    return jax.device_get(
        quickly(partial(FusedEngine().reset, scene.spec))(scene.fleet, scene.worlds)
    )


def flown(scene, begun, engine):
    """State after some steps under signals, and the sample of the last."""
    shape = (STEPS, *scene.worlds.variant.shape, scene.fleet.control.vehicle.B.shape[-1])
    signals = np.random.default_rng(0).uniform(1400, 1600, shape)
    step, state = quickly(partial(engine.control_step, scene.spec)), begun
    for row in signals:
        command = ThrusterPwm(pwm_us=jnp.asarray(row, jnp.float32))
        state, sample = jax.device_get(step(scene.fleet, scene.worlds, state, command))
    return state, sample


@pytest.fixture(scope="module")
def by_mjx(scene, begun):
    return flown(scene, begun, by_name("mjx", "xla"))


@pytest.mark.parametrize("kernels", ["xla", "cuda"])
def test_the_engines_agree(scene, begun, by_mjx, kernels, deviation):
    engine = FusedEngine() if kernels == "xla" else CudaEngine(block=2)
    state, sample = flown(scene, begun, engine)
    theirs, seen = by_mjx
    deviation.close(f"sea.{kernels}", sample.current_mps, seen.current_mps, rtol=0, atol=2e-6)
    # Two steps: an ulp or two of 12 m.
    deviation.close(f"sea.{kernels}", state.vehicles.p, theirs.vehicles.p, rtol=0, atol=4e-6)
    deviation.close(f"sea.{kernels}", state.vehicles.nu, theirs.vehicles.nu, rtol=0, atol=4e-6)
    moved = np.asarray(state.vehicles.p) - np.asarray(begun.vehicles.p)
    assert np.abs(moved).max() > 0.003


def test_water_at_the_robots_is_that_of_the_components(scene, begun, by_mjx):
    """By the closed forms and a file's own numbers, at the places of the last sample."""
    _, sample = by_mjx
    t = (STEPS - 1) * scene.spec.control_dt_s
    for world in range(WORLDS):
        current = jax.tree.map(lambda leaf, i=world: leaf[i], scene.worlds.environment.current)
        p = sample.p[world, 0] if hasattr(sample, "p") else None
        whole = currents.velocity(current, jnp.asarray(p), jnp.asarray(t))
        np.testing.assert_allclose(sample.current_mps[world, 0], whole, atol=2e-6)
    speeds = np.linalg.norm(sample.current_mps[:, 0], axis=1)
    assert np.ptp(speeds) > 0.05, "worlds lie at places of their own"


@pytest.mark.usefixtures("as_if_on_an_h200")
@pytest.mark.parametrize("kernels", ["xla", "cuda"])
def test_a_program_holds_the_field_once(scene, begun, kernels):
    """Not for every world; and the kernels that look it up lower for CUDA."""
    engine = FusedEngine() if kernels == "xla" else CudaEngine()
    field = scene.worlds.environment.current[0].field
    run = partial(engine.segment, scene.spec, n_sample=1, steps_per_sample=2)
    platform = "cpu" if kernels == "xla" else "cuda"
    traced = jax.jit(run).trace(scene.fleet, scene.worlds, begun)
    text = traced.lower(lowering_platforms=(platform,)).as_text()
    name = f"tensor<{field.numbers[0].size}xf32>"
    lines = [line for line in text.splitlines() if line.endswith(name)]
    assert sum("stablehlo.constant dense" in line for line in lines) == 1
    assert f"x{field.numbers[0].size}xf32" not in text
    assert text.count("__gpu$xla.gpu.ptx") == (3 + 3 if kernels == "cuda" else 0)
