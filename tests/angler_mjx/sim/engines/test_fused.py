"""The fused engine against mjx on random worlds: every vehicle and parameter set, in float64.

In float64 rounding has no room to grow, so what is left to see is the equations. How float32
differs is measured by `angler_experiments.engine_parity`, on whole episodes.
"""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.robot.control.commands.joint_trajectory import from_path
from angler_mjx.sim.engines.cuda.engine import CudaEngine
from angler_mjx.sim.state import Outcome, Touched
from angler_mjx.testing import referee

from ... import declared
from ...compiling import quickly
from .stored import store

# Asked for; found is 1e-13, on numbers of up to 1e3 (forces) and after 1,000 physics steps.
TOLERANCE = 1e-9


@pytest.fixture(
    scope="module",
    params=[
        "closed loop",
        pytest.param("random signals", marks=pytest.mark.nightly(by="closed loop")),
        pytest.param("along joints", marks=pytest.mark.nightly(by="closed loop; test_plans.py")),
    ],
)
def pair(request, double, jointed, play):
    """The final states, and samples of every step [steps, W, ...], of both engines."""
    scene = jointed if request.param == "along joints" else double
    commanded = request.param == "random signals"
    return request.param, play(scene, "mjx", commanded), play(scene, "fused", commanded)


@pytest.fixture(scope="module")
def jointed(double):
    """The worlds with plans that are trajectories of joints, of 1,024 points."""
    path, yaw = jax.device_get((double.worlds.path, double.worlds.environment.start_yaw_rad))

    def edge(leaf):
        more = [(0, 0)] * 2 + [(0, 1024 - leaf.shape[2])] + [(0, 0)] * (leaf.ndim - 3)
        return np.pad(leaf, more, mode="edge")

    many = replace(path, time_s=edge(path.time_s), position_m=edge(path.position_m))
    with jax.enable_x64(True):
        joints = jax.device_get(quickly(jax.vmap(jax.vmap(from_path)))(many, yaw))
    return replace(double, worlds=replace(double.worlds, path=joints))


def assert_close(deviation, key, ours, theirs):
    for (path, x), y in zip(
        jax.tree_util.tree_leaves_with_path(ours), jax.tree.leaves(theirs), strict=True
    ):
        name = jax.tree_util.keystr(path)
        if jnp.issubdtype(y.dtype, jnp.floating):
            deviation.close(key, x, y, rtol=TOLERANCE, atol=TOLERANCE, marks=True, about=name)
        else:
            np.testing.assert_array_equal(x, y, err_msg=name)


def test_states_and_samples_are_those_of_mjx(pair, deviation):
    name, theirs, ours = pair
    key = "random_signals" if name == "random signals" else "closed_loop"
    assert_close(deviation, f"fused.{key}", ours, theirs)


def test_samples_have_the_declared_shapes(pair, double):
    n_obstacle = double.worlds.environment.obstacles.kind.shape[-1]
    sizes = {"robot": 6, "thruster": 8, "obstacle": n_obstacle}
    for _, sample in pair[1:]:
        declared.check(sample, (200, 8), sizes)


def test_the_worlds_are_worth_comparing(pair, double):
    name, (after, samples), _ = pair
    assert after.vehicles.p.dtype == np.float64
    # Every variant there is, two kinds of bodies; most robots go some way.
    assert set(np.unique(double.worlds.variant)) == set(range(5))
    assert np.median(after.tally.path_length_m) > 1.0
    ends = set(np.unique(after.tally.outcome))
    common = {Outcome.RUNNING, Outcome.COLLISION_DYNAMIC}
    wanted = {*common, Outcome.REACHED, Outcome.COLLISION_STATIC}
    if name == "random signals":
        wanted = {*common, Outcome.OUT_OF_BOUNDS}
    assert wanted <= ends
    assert Touched.OBSTACLE in np.unique(after.tally.touched)
    if name == "random signals":
        # It turns over: attitudes far from level.
        assert np.abs(samples.q[..., 1:3]).max() > 0.3
    moving = np.asarray(double.worlds.environment.obstacles.motion)
    assert len(np.unique(moving)) == 5
    assert np.ptp(samples.obstacle_p, axis=0).max() > 0.5


@pytest.mark.parametrize("engine", ["mjx", "fused"])
def test_the_referee_agrees_with_every_account(engine, pair, double, jointed, members, tmp_path):
    """Outcomes, times, ways, energies, distances and touches, worked out anew from the samples.

    Stored in float32, judged in float64, and decided in float64: nothing is left to rounding but
    what lies within it.
    """
    name, mjx, fused = pair
    after, samples = {"mjx": mjx, "fused": fused}[engine]
    scene = jointed if name == "along joints" else double
    path = store(tmp_path / "run", scene, members, after, samples)
    assert (path / "trajectories.zarr" / "plan_degree").exists() == (name == "along joints")
    verdict = referee.judge(path)
    assert [one.line() for one in verdict.differences] == []
    assert verdict.robots == after.tally.outcome.size
    counts = verdict.counts
    bounded = counts.pop("impact_speed_mps").bounded  # of touches with what moves
    assert bounded == np.sum(after.tally.outcome == Outcome.COLLISION_DYNAMIC)
    assert {count.exact for count in counts.values()} == {verdict.robots}
    assert counts["path_length_m"].largest < 1e-4
    assert counts["energy_j"].largest < 1e-5


def test_a_mixed_fleet_is_grouped_by_vehicle(double):
    assert [(group.first, group.count) for group in double.fleet.groups] == [(0, 4), (4, 2)]


def test_reset_is_that_of_mjx(double, begun, deviation):
    assert_close(deviation, "fused.reset", begun(double, "fused"), begun(double, "mjx"))


@pytest.mark.usefixtures("as_if_on_an_h200")
def test_kernels_lower_for_cuda(double, begun):
    """The compiler knows every operation in them; no device is needed for that."""
    given = double.fleet, double.worlds, begun(double, "fused")
    given = jax.tree.map(
        lambda x: np.asarray(x, np.float32) if jnp.issubdtype(x.dtype, jnp.floating) else x, given
    )
    segment = partial(CudaEngine().segment, double.spec, n_sample=2, steps_per_sample=2)
    traced = jax.jit(segment).trace(*given)
    text = traced.lower(lowering_platforms=("cuda",)).as_text()
    # Control, motion and judgement of each of two groups, and the obstacles, for all launches; to
    # lay out robots, obstacles and last approaches.
    assert text.count("__gpu$xla.gpu.ptx") == 7 + 3
    n_obstacle = double.worlds.environment.obstacles.kind.shape[-1]
    sizes = {"robot": 6, "thruster": 8, "obstacle": n_obstacle}
    declared.check(traced.out_info[1], (8, 2), sizes, dtype=jnp.float32)
