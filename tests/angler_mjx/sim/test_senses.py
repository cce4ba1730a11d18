"""What controllers are told: exactly the truth without noise, and the same in every engine."""

from dataclasses import dataclass, replace
from functools import partial
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.robot.control import stages
from angler_mjx.robot.control.commands.joint_trajectory import from_path
from angler_mjx.robot.sensing.config import SensorsConfig
from angler_mjx.scenario import instrumented
from angler_mjx.sim import sensing
from angler_mjx.sim.engines.cuda.engine import CudaEngine
from angler_mjx.sim.engines.lanes.engine import FusedEngine
from angler_mjx.sim.engines.mjx import MjxEngine
from angler_mjx.sim.physics.step import VehicleState
from angler_mjx.sim.policy import Policy
from angler_mjx.sim.state import SimSpec
from angler_mjx.world.rock.grid import Grid, height_above_bottom

from .. import declared
from ..compiling import quickly

WORLDS, SAMPLES, EVERY = 2, 12, 5
ALL = {"usbl": {"fitted": True, "latency_s": 0.3, "period_s": 0.5}, "gps": {"fitted": True}}
EXACT = {"noise": False}
TOLD = [("truth", {}), ("noisy", {}), ("ekf", ALL), ("ekf", {})]


def tell(scene, told, controller="cascade", numbers=()):
    """A scene whose robots are told of themselves, and whose controllers use the current."""
    robots = [(source, SensorsConfig.model_validate(tables)) for source, tables in told]
    spec = scene.spec
    controllers, gains = stages.build_stack(stages.CONTROLLERS[controller], dict(numbers))
    spec = replace(
        spec,
        stages=controllers,
        gains=gains,
        instrumented=instrumented.build_groups(robots, spec.control_dt_s, spec.water.gravity_mps2),
    )
    keys = jax.random.split(jax.random.key(5), (WORLDS, len(robots)))
    keyed = replace(scene.worlds, sensing_key=jax.random.key_data(keys))
    return replace(scene, spec=spec, worlds=keyed if spec.instrumented else scene.worlds)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Pilot(Policy):
    """Trajectories of joints along the paths with a heading of its own; keeps what it was told."""

    def reset(self, known, key):
        return known.belief.p, jax.random.uniform(key, (len(TOLD),))

    def act(self, carry, known, key, step):
        return (known.belief.p, carry[1]), jax.vmap(from_path)(known.path, carry[1])


def begin(scene, policy=None):
    """The state at t = 0. One for all: it is the same to rounding (test_fused)."""
    reset = quickly(partial(FusedEngine().reset, scene.spec))
    return jax.device_get(reset(scene.fleet, scene.worlds, policy))


def fly(engine, scene, start, samples=SAMPLES, policy=None):
    """Final state and samples [W, samples, R, ...]."""
    count = {"n_sample": samples, "steps_per_sample": EVERY}
    run = quickly(partial(engine.segment, scene.spec, **count))
    return jax.device_get(run(scene.fleet, scene.worlds, start, policy=policy))


def assert_close(ours, theirs, tolerance):
    for (path, x), y in zip(
        jax.tree_util.tree_leaves_with_path(ours), jax.tree.leaves(theirs), strict=True
    ):
        name = jax.tree_util.keystr(path)
        if jnp.issubdtype(y.dtype, jnp.floating):
            np.testing.assert_allclose(x, y, rtol=tolerance, atol=tolerance, err_msg=name)
        else:
            np.testing.assert_array_equal(x, y, err_msg=name)


@pytest.fixture(scope="module")
def place(scenes):
    """Two worlds of four robots of a kind, without obstacles, in float64."""
    build, members, obstacles = scenes
    with jax.enable_x64(True):
        return build(WORLDS, members=members("bluerov2") * len(TOLD), config=obstacles["none"])


@pytest.fixture(scope="module")
def double(place):
    """In float64: the scene, its start, and how mjx flies the trajectories of a policy.

    Under a law that wants the current and the wrench that was realised.
    """
    with jax.enable_x64(True):
        scene = tell(place, TOLD, "tracking", {"reference": {"lag_slow_m": 0.2}})
        keys = jax.random.key_data(jax.random.split(jax.random.key(6), WORLDS))
        scene = replace(scene, worlds=replace(scene.worlds, policy_key=keys))
        start = begin(scene, Pilot())
        return scene, start, fly(MjxEngine(), scene, start, policy=Pilot())


@pytest.mark.nightly(
    by="test_each_robot_is_told_what_it_is_to_be_told by mjx; test_watching.py by the fused engine"
)
def test_the_fused_engine_tells_the_same_and_flies_it_alike(double):
    scene, start, theirs = double
    with jax.enable_x64(True):
        ours = fly(FusedEngine(), scene, start, policy=Pilot())
    # As for all of an engine in float64: rounding has no room to grow.
    assert_close(ours, theirs, 1e-9)


def test_what_is_told_is_followed_and_has_the_declared_shapes(double):
    scene, _, (after, seen) = double
    n_obstacle = scene.worlds.environment.obstacles.kind.shape[-1]
    sizes = {"robot": 4, "thruster": 6, "obstacle": n_obstacle}
    declared.check(seen, (WORLDS, SAMPLES), sizes, told=True)
    assert np.abs(after.carry.realised.tau).max() > 1.0
    # Followed, not the path: a line from way-point to way-point is the same, but not the heading.
    assert np.all(after.carry.stages[0].clock_s > 0.5)


@pytest.mark.nightly(by="test_each_robot_is_told_what_it_is_to_be_told")
def test_kernels_tell_the_same(double):
    scene, start, (_, theirs) = double
    with jax.enable_x64(True):
        _, ours = fly(CudaEngine(block=2, interpret=True), scene, start, 3, Pilot())
    assert_close(ours, jax.tree.map(lambda x: x[:, :3], theirs), 1e-9)


def test_each_robot_is_told_what_it_is_to_be_told(double):
    *_, (after, seen) = double
    belief, dt = seen.belief, 0.05
    for name in ("p", "q", "nu"):
        np.testing.assert_array_equal(getattr(belief, name)[:, :, 0], getattr(seen, name)[:, :, 0])
    np.testing.assert_array_equal(belief.flow[:, :, 0], seen.current_mps[:, :, 0])
    assert not belief.position_std_m[:, :, 0].any()
    off = belief.p - seen.p
    # White noise of 2 cm; 72 numbers give its size to 8 %, four of those.
    assert np.std(off[:, :, 1]) == pytest.approx(0.02, rel=0.3)
    np.testing.assert_allclose(belief.position_std_m[:, :, 1], 0.02)
    # Filters: within four and a half of their own standard deviations (one in 1e5).
    for robot in (2, 3):
        assert np.all(np.abs(off[:, :, robot]) < 4.5 * belief.position_std_m[:, :, robot])
    # No instrument shows the current: still water.
    assert not belief.flow[:, :, 2:].any()
    assert np.abs(seen.current_mps).max() > 0.05
    # Keys of their own: the two filters begin differently, and so do the worlds.
    assert len(np.unique(np.round(off[:, 0, 2:, 0], 9))) == 2 * WORLDS
    assert after.senses[0] is None
    assert after.senses[1].filter.covariance.shape == (WORLDS, 2, 19, 19)
    assert SAMPLES * EVERY * dt == 3.0


SOURCES = [("truth", {})] * 2 + [("ekf", EXACT)] * 2
CHANGED = np.array([2, 3, 0, 1])
"""The second world is the first with its robots in this order, so that each flies by the truth in
one of them, and by a filter in the other."""


@pytest.fixture(scope="module")
def exact(place):
    """In float32: two robots that are told the truth, and two with filters of exact instruments."""
    first = jax.tree.map(lambda leaf: single(np.asarray(leaf)[0]), place.worlds)
    environment, there = first.environment, {}
    for name in ("start_m", "start_yaw_rad", "goal_m", "path_ratio", "line_free"):
        there[name] = getattr(environment, name)[CHANGED]
    of_robots = {"variant": first.variant, "control": first.control, "path": first.path}
    moved = jax.tree.map(lambda leaf: leaf[CHANGED], of_robots | {"body": first.body})
    second = replace(first, environment=replace(environment, **there), **moved)
    worlds = jax.tree.map(lambda *leaves: np.stack(leaves), first, second)
    fleet = jax.tree.map(single, place.fleet)
    return tell(replace(place, worlds=worlds, fleet=fleet), SOURCES)


def single(leaf):
    return np.asarray(leaf, np.float32) if jnp.issubdtype(leaf.dtype, jnp.floating) else leaf


@pytest.fixture(scope="module")
def in_single(exact):
    return fly(FusedEngine(), exact, begin(exact))[1]


@pytest.mark.nightly(
    by="control/test_navigation.py::test_without_noise_the_filter_stays_on_the_truth, the filter; "
    "test_each_robot_is_told_what_it_is_to_be_told, what controllers get"
)
def test_without_noise_the_filter_is_near_the_truth(in_single):
    p, believed = in_single.p, in_single.belief.p
    assert p.dtype == np.float32
    # The filter reckons by the trapezoidal rule: off by dt^2 / 12 times the change of acceleration
    # in a period, which is 1 m/s^2 where thrusters start.
    np.testing.assert_allclose(believed, p, atol=3e-4)
    assert np.abs(believed - p)[:, :, 2:].max() > 0.0
    # The robot goes where the filter takes it to be.
    by_truth, by_filter = p[:, :, :2], p[::-1, :, 2:]
    np.testing.assert_allclose(by_filter, by_truth, atol=6e-4)
    assert np.abs(np.diff(by_truth, axis=1)).max() > 0.05
    assert np.ptp(by_truth[:, 0, :, 2]) > 1.0


@pytest.mark.nightly(by="the same in float64, and test_without_noise_the_filter_is_near_the_truth")
def test_in_float32_engines_differ_by_rounding(exact, in_single):
    ours, theirs = in_single, fly(MjxEngine(), exact, begin(exact))[1]
    # Three seconds: 1e-6 m of rounding at 12 m in each of 60 steps, fed back through controllers.
    np.testing.assert_allclose(ours.p, theirs.p, atol=3e-5)
    np.testing.assert_allclose(ours.belief.p, theirs.belief.p, atol=3e-5)
    np.testing.assert_allclose(ours.belief.nu, theirs.belief.nu, atol=3e-4)


@pytest.mark.parametrize(("before", "noisy", "after"), [(1, 3, 1), (0, 3, 2), (0, 3, 0), (1, 1, 0)])
def test_only_robots_that_are_told_with_noise_are(before, noisy, after):
    config, n = SensorsConfig(), before + noisy + after
    sources = ["truth"] * before + ["noisy"] * noisy + ["truth"] * after
    groups = instrumented.build_groups([(source, config) for source in sources], 0.05, 9.81)
    grid = Grid(
        occupied=jnp.zeros((2, 2, 2), bool),
        origin_m=jnp.array([-9.0, -9.0, -20.0]),
        cell_m=jnp.asarray(9.0),
    )
    world = SimpleNamespace(
        factors=None,
        environment=SimpleNamespace(grid=grid, floor_z_m=jnp.asarray(-20.0)),
        sensing_key=jax.random.key_data(jax.random.split(jax.random.key(0), n)),
    )
    robots = VehicleState(
        p=jnp.arange(3.0 * n).reshape(n, 3) - 12.0,
        q=jnp.tile(jnp.array([1.0, 0.0, 0.0, 0.0]), (n, 1)),
        nu=jnp.ones((n, 6)),
        force_before=jnp.zeros((n, 6)),
        thrust=jnp.zeros((n, 8)),
    )
    spec = SimSpec(instrumented=groups)

    @quickly
    def one(robots, flow):
        memory = sensing.reset(spec, world, robots)
        return sensing.step(spec, world, memory, jnp.int32(3), robots, flow)[1]

    belief = one(robots, jnp.ones((n, 3)))
    for told, true in (
        (belief.p, robots.p),
        (belief.nu, robots.nu),
        (belief.flow, np.ones((n, 3))),
    ):
        off = np.any(np.asarray(told) != np.asarray(true), axis=1)
        np.testing.assert_array_equal(off, [source == "noisy" for source in sources])


def test_truth_without_noise_is_the_truth():
    told = [("truth", {}), ("noisy", EXACT), ("noisy", {}), ("ekf", EXACT), ("ekf", {})]
    robots = [(source, SensorsConfig.model_validate(tables)) for source, tables in told]
    built = instrumented.build_groups(robots, 0.05, 9.81)
    assert [(group.first, group.count, group.source) for group in built] == [
        (2, 1, "noisy"),
        (3, 1, "ekf"),
        (4, 1, "ekf"),
    ]
    assert [group.params.sensors.noise for group in built] == [True, False, True]


def test_height_above_bottom_is_that_of_the_first_rock_below():
    rng = np.random.default_rng(0)
    occupied = rng.random((4, 5, 6)) < 0.3
    grid = Grid(
        occupied=jnp.asarray(occupied),
        origin_m=jnp.array([-2.0, 1.0, -9.0]),
        cell_m=jnp.asarray(1.5),
    )
    points = rng.uniform([-3.0, 0.0, -9.0], [5.0, 9.5, 0.5], (200, 3))
    ours = jax.vmap(height_above_bottom, (None, None, 0))(grid, jnp.asarray(-9.5), points)
    for p, height in zip(points, ours, strict=True):
        i, j = np.floor((p[:2] - [-2.0, 1.0]) / 1.5).astype(int)
        tops = [-9.5]
        if 0 <= i < 4 and 0 <= j < 5:
            tops += [-9.0 + 1.5 * (k + 1) for k in range(6) if occupied[i, j, k]]
        # float32 of heights of ten metres.
        expected = p[2] - max(top for top in tops if top <= p[2])
        assert height == pytest.approx(expected, abs=1e-5)
