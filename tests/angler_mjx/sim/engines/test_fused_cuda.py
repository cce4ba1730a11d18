"""The CUDA kernels against the other engines, interpreted here.

That they lower for CUDA is asked in `test_fused`.
"""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.robot.control.commands import ThrusterPwm
from angler_mjx.sim.engines.base import by_name, default_kernels
from angler_mjx.sim.engines.cuda.engine import CudaEngine
from angler_mjx.sim.engines.lanes.engine import FusedEngine
from angler_mjx.sim.state import Touched

from ...compiling import quickly

EVERY = 4
"""Control steps from one sample to the next."""


def assert_close(deviation, key, ours, theirs, tolerance):
    for (path, x), y in zip(
        jax.tree_util.tree_leaves_with_path(ours), jax.tree.leaves(theirs), strict=True
    ):
        name = jax.tree_util.keystr(path)
        if jnp.issubdtype(y.dtype, jnp.floating):
            deviation.close(key, x, y, rtol=tolerance, atol=tolerance, marks=True, about=name)
        else:
            np.testing.assert_array_equal(x, y, err_msg=name)


@pytest.mark.nightly(by="a control step of these kernels is, in test_control_step_takes_signals")
def test_segment_is_that_of_mjx(double, play, deviation):
    """A mixed fleet among obstacles; 6 worlds in programs of 4, so that two lanes are padding."""
    n, engine = 6, CudaEngine(block=4, interpret=True)
    after, samples = play(double, "mjx", False)
    steps = samples.p.shape[0]
    theirs = jax.tree.map(lambda x: x[:n], after)
    theirs_seen = jax.tree.map(lambda x: jnp.moveaxis(x, 0, 1)[:n, ::EVERY], samples)
    with jax.enable_x64(True):
        worlds = jax.tree.map(lambda x: x[:n], double.worlds)
        start = quickly(partial(engine.reset, double.spec))(double.fleet, worlds)
        count = {"n_sample": steps // EVERY, "steps_per_sample": EVERY}
        run = quickly(partial(engine.segment, double.spec, **count))
        ours, seen = run(double.fleet, worlds, start)
    # As for the fused engine: float64 leaves rounding no room; found is 1e-13.
    assert_close(deviation, "cuda.segment", ours, theirs, 1e-9)
    assert_close(deviation, "cuda.segment", seen, theirs_seen, 1e-9)
    assert {Touched.CELL, Touched.OBSTACLE} <= set(np.unique(theirs.tally.touched))


@pytest.mark.usefixtures("compiled_sources")
def test_control_step_takes_signals(scenes, deviation):
    """One kind of robot, nothing to meet, float32, signals from outside."""
    build, members, obstacles = scenes
    scene = build(3, members=members("bluerov2"), config=obstacles["none"])
    shape = (8, *scene.worlds.variant.shape, scene.fleet.control.vehicle.B.shape[-1])
    signals = np.random.default_rng(0).uniform(1300, 1700, shape)
    # One for both: it is the same to rounding (test_fused). In numpy, as it is compiled once so.
    start = quickly(partial(FusedEngine().reset, scene.spec))(scene.fleet, scene.worlds)
    start, ends = jax.device_get(start), []
    for engine in (CudaEngine(block=2), by_name("mjx", "xla")):
        state, step = start, quickly(partial(engine.control_step, scene.spec))
        for row in signals:
            command = ThrusterPwm(pwm_us=jnp.asarray(row, jnp.float32))
            after = step(scene.fleet, scene.worlds, state, command)
            state, sample = jax.device_get(after)
        ends.append((state.vehicles, state.step, sample))
    # Eight steps: an ulp or two of 12 m, and as much of forces of 120 N.
    assert_close(deviation, "cuda.single", ends[0][0].p, ends[1][0].p, 4e-6)
    assert_close(deviation, "cuda.single", ends[0][0].nu, ends[1][0].nu, 4e-6)
    np.testing.assert_array_equal(ends[0][1], ends[1][1])
    np.testing.assert_array_equal(ends[0][2].pwm_us, signals[-1].astype(np.float32))
    assert np.abs(ends[0][0].nu).max() > 0.1


@pytest.mark.nightly(by="a control step of these kernels is, in test_control_step_takes_signals")
def test_worlds_of_a_bank_at_their_own_times(scenes, deviation):
    """One control step of five worlds of three, in any order and each at a time of its own."""
    build, members, obstacles = scenes
    scene = build(3, members=members("bluerov2"), config=obstacles["all"])
    rows = jnp.array([2, 0, 1, 2, 0], jnp.int32)
    start = quickly(partial(FusedEngine().reset, scene.spec))(scene.fleet, scene.worlds)
    state = jax.tree.map(lambda leaf: leaf[rows], start)
    state = replace(state, step=jnp.array([0, 7, 300, 41, 2], jnp.int32))
    ends = []
    for engine in (CudaEngine(block=2, interpret=True), FusedEngine()):
        step = quickly(partial(engine.control_step, scene.spec))
        after = step(scene.fleet, scene.worlds, state, None, None, rows)
        ends.append(jax.device_get(after))
    assert_close(deviation, "cuda.rows", *ends, 4e-6)
    # Time tells: the third world's obstacles drift in another current than at its beginning.
    plain = quickly(partial(FusedEngine().control_step, scene.spec))
    alone = plain(scene.fleet, scene.worlds, start, None)[0]
    assert np.abs(alone.vehicles.nu[1] - ends[0][0].vehicles.nu[2]).max() > 1e-6
    np.testing.assert_array_equal(ends[0][0].step, state.step + 1)


def test_chosen_by_name():
    assert isinstance(by_name("fused", "cuda"), CudaEngine)
    assert isinstance(by_name("fused", "xla"), FusedEngine)
    assert default_kernels("fused", "cpu") == "xla"
    assert default_kernels("fused", "gpu") == "cuda"
    assert default_kernels("mjx", "gpu") == "xla"


@pytest.mark.gpu
@pytest.mark.skipif(jax.default_backend() != "gpu", reason="needs a CUDA device")
def test_segment_on_the_device_is_that_of_xla(scenes):
    build, _, _ = scenes
    scene = build(100)
    ends = []
    for engine in (CudaEngine(), FusedEngine()):
        state = jax.jit(partial(engine.reset, scene.spec))(scene.fleet, scene.worlds)
        run = jax.jit(partial(engine.segment, scene.spec, n_sample=2, steps_per_sample=5))
        ends.append(run(scene.fleet, scene.worlds, state))
    (ours, _), (theirs, _) = ends
    # Half a second: 50 roundings of the position, ulp 1e-6 m; see engine_parity for the bound.
    np.testing.assert_allclose(ours.vehicles.p, theirs.vehicles.p, atol=2e-5)
    same = np.asarray(ours.tally.outcome) == np.asarray(theirs.tally.outcome)
    assert same.mean() > 0.99
