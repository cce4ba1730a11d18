"""What is recorded only where it is asked for: thrusters' wrench and distances, in every engine."""

from dataclasses import replace
from functools import partial

import jax
import numpy as np
import pytest

from angler_mjx.sim.engines.cuda.engine import CudaEngine
from angler_mjx.sim.engines.lanes.engine import FusedEngine
from angler_mjx.sim.engines.mjx import MjxEngine
from angler_mjx.sim.state import Outcome

from ... import declared
from ...compiling import quickly

pytestmark = pytest.mark.usefixtures("compiled_sources")  # kernels run here, as C

ALSO = ("wrench", "clearance")
COUNT = {"n_sample": 3, "steps_per_sample": 2}


@pytest.fixture(scope="module")
def scene(scenes):
    """Two worlds of one robot among obstacles."""
    build, members, obstacles = scenes
    return build(2, members=members("bluerov2") * 2, config=obstacles["all"])


@pytest.fixture(scope="module")
def begun(scene):
    """The state at the start; robot 1 of world 1 had diverged."""
    start = quickly(partial(FusedEngine().reset, scene.spec))(scene.fleet, scene.worlds)
    outcome = start.tally.outcome.at[1, 1].set(Outcome.DIVERGED)
    return jax.device_get(replace(start, tally=replace(start.tally, outcome=outcome)))


def program(scene, engine, also):
    """A segment of an engine as a function of the state."""
    run = quickly(partial(engine.segment, replace(scene.spec, also=also), **COUNT))
    return lambda state: jax.device_get(run(scene.fleet, scene.worlds, state))


@pytest.fixture(scope="module")
def fused(scene):
    """The fused engine with all that can be asked for."""
    return program(scene, FusedEngine(), ALSO)


@pytest.fixture(scope="module")
def flown(fused, begun):
    """The state after a segment of it, and the samples."""
    return fused(begun)


@pytest.fixture(scope="module")
def seen(flown):
    """The samples."""
    return flown[1]


@pytest.mark.nightly(by="test_asked_fields_are_as_declared")
def test_what_all_runs_have_stays_the_same(scene, begun, seen):
    """To the bit with distances; a compiler may round otherwise beside a wrench."""
    _, plain = program(scene, FusedEngine(), ())(begun)
    assert plain.wrench is None
    assert plain.clearance is None
    _, near = program(scene, FusedEngine(), ("clearance",))(begun)
    jax.tree.map(np.testing.assert_array_equal, replace(near, clearance=None), plain)
    without = replace(seen, wrench=None, clearance=None)
    jax.tree.map(partial(np.testing.assert_allclose, rtol=1e-5, atol=1e-5), without, plain)


def test_asked_fields_are_as_declared(scene, seen):
    sizes = {
        "robot": 2,
        "thruster": scene.fleet.control.vehicle.B.shape[-1],
        "obstacle": scene.worlds.environment.obstacles.kind.shape[1],
    }
    declared.check(seen, (2, 3), sizes, also=ALSO, dtype=np.float32)


@pytest.mark.parametrize(
    "engine",
    [
        MjxEngine(),
        pytest.param(CudaEngine(block=2), marks=pytest.mark.nightly(by="MjxEngine")),
    ],
    ids=["mjx", "cuda"],
)
def test_engines_agree(scene, begun, seen, engine):
    _, theirs = program(scene, engine, ALSO)(begun)
    np.testing.assert_allclose(theirs.wrench, seen.wrench, rtol=1e-4, atol=2e-3)
    both = zip(jax.tree.leaves(seen.clearance), jax.tree.leaves(theirs.clearance), strict=True)
    for ours, other in both:
        np.testing.assert_allclose(ours, other, rtol=0, atol=2e-5)


def test_wrench_is_that_of_the_thrusts_of_the_state(scene, fused, flown):
    """Zero at rest, then the sum over thrusters of force and lever; NaN where a robot diverged."""
    after, seen = flown
    assert np.isnan(seen.wrench[1, :, 1]).all()
    np.testing.assert_array_equal(seen.wrench[0, 0], 0.0)
    _, following = fused(after)
    vehicle = jax.device_get(scene.equipped.control.vehicle)
    for robot in range(2):
        thrust = np.float64(after.vehicles.thrust[0, robot])
        thrust = thrust if thrust.ndim == 1 else thrust[0]
        given = np.sum(np.float64(vehicle.B[0, robot]) * thrust, axis=1)
        assert np.abs(given).max() > 1.0
        found = following.wrench[0, 0, robot]
        np.testing.assert_allclose(found, given, rtol=1e-5, atol=1e-4)


def hull_points(vehicle, p, q, count=400):
    """Points [n, 3] along the axes of the capsules and their radii [n]."""
    w, x, y, z = np.float64(q)
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    a, b, r = (np.float64(vehicle[name]) for name in ("a", "b", "r"))
    share = np.linspace(0.0, 1.0, count)[:, None, None]
    points = (a + share * (b - a)).reshape(-1, 3) @ turn.T + np.float64(p)
    return points, np.tile(r, count)


def test_clearance_is_that_of_brute_force(scene, seen):
    """To all cells as boxes and the floor, capped; and between hulls, from points on their axes."""
    worlds = jax.device_get(scene.equipped)
    environment, vehicles = worlds.environment, worlds.control.vehicle
    for world in range(2):
        grid = environment.grid
        cell, origin = grid.cell_m[world], grid.origin_m[world]
        low = origin + cell * np.argwhere(grid.occupied[world])
        hulls = []
        for robot in range(2):
            of = {name: getattr(vehicles, f"capsule_{name}_m")[world, robot] for name in "abr"}
            p, q = seen.p[world, -1, robot], seen.q[world, -1, robot]
            points, r = hull_points(of, p, q)
            hulls.append((points, r))
            off = points[:, None] - np.clip(points[:, None], low, low + cell)
            gap = np.min(np.linalg.norm(off, axis=2) - r[:, None], initial=np.inf)
            cap = cell - np.max(np.linalg.norm(points - p, axis=1) + r)
            floor = np.min(points[:, 2] - r) - environment.floor_z_m[world]
            found = seen.clearance.rock_m[world, -1, robot]
            np.testing.assert_allclose(found, min(gap, cap, floor), atol=2e-3)
        (one, r), (other, s) = hulls
        gap = np.linalg.norm(one[:, None] - other[None], axis=2) - r[:, None] - s[None]
        np.testing.assert_allclose(
            seen.clearance.robot_m[world, -1], min(gap.min(), 1.0), atol=2e-3
        )
        assert np.isfinite(seen.clearance.obstacle_m[world]).all()
