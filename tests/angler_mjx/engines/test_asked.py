"""What is recorded only where it is asked for: thrusters' wrench and distances, in every engine."""

from dataclasses import replace
from functools import partial

import jax
import numpy as np
import pytest

from angler_mjx.engines.base import by_name
from angler_mjx.engines.triton.engine import TritonEngine
from angler_mjx.sim.state import Outcome

from .. import declared
from ..compiling import quickly

ALSO = ("wrench", "clearance")
COUNT = {"n_sample": 3, "steps_per_sample": 2}


@pytest.fixture(scope="module")
def scene(scenes):
    """Two worlds of one robot among obstacles."""
    build, members, obstacles = scenes
    return build(2, members=members("bluerov2") * 2, config=obstacles["all"])


@pytest.fixture(scope="module")
def fly(scene):
    """A function (engine, what is asked for) -> samples; robot 1 of world 1 had diverged."""
    start = quickly(partial(by_name("fused", "xla").reset, scene.spec))(scene.fleet, scene.worlds)
    outcome = start.tally.outcome.at[1, 1].set(Outcome.DIVERGED)
    start = jax.device_get(replace(start, tally=replace(start.tally, outcome=outcome)))

    def fly(engine, also):
        spec = replace(scene.spec, also=also)
        run = quickly(partial(engine.segment, spec, **COUNT))
        return jax.device_get(run(scene.fleet, scene.worlds, start)[1])

    return fly


@pytest.fixture(scope="module")
def seen(fly):
    """Samples of the fused engine with all that can be asked for."""
    return fly(by_name("fused", "xla"), ALSO)


def test_what_all_runs_have_stays_the_same_to_the_bit(fly, seen):
    plain = fly(by_name("fused", "xla"), ())
    assert plain.wrench is None
    assert plain.clearance is None
    without = replace(seen, wrench=None, clearance=None)
    jax.tree.map(np.testing.assert_array_equal, without, plain)


def test_asked_fields_are_as_declared(scene, seen):
    sizes = {
        "robot": 2,
        "thruster": scene.fleet.control.vehicle.B.shape[-1],
        "obstacle": scene.worlds.environment.obstacles.kind.shape[1],
    }
    declared.check(seen, (2, 3), sizes, also=ALSO, dtype=np.float32)


@pytest.mark.parametrize(
    "engine", [by_name("mjx", "xla"), TritonEngine(lanes=2, interpret=True)], ids=["mjx", "triton"]
)
def test_engines_agree(fly, seen, engine):
    theirs = fly(engine, ALSO)
    np.testing.assert_allclose(theirs.wrench, seen.wrench, rtol=1e-4, atol=2e-3)
    for ours, other in zip(
        jax.tree.leaves(seen.clearance), jax.tree.leaves(theirs.clearance), strict=True
    ):
        np.testing.assert_allclose(ours, other, rtol=0, atol=2e-5)


def test_wrench_is_of_thrusts_behind_their_lag(scene, fly, seen):
    """Zero at rest, then the sum over thrusters of what each gives; NaN where a robot diverged."""
    assert np.isnan(seen.wrench[1, 1]).all()
    sound = seen.wrench[[0, 0, 1], :, :][:, :, 0]
    np.testing.assert_array_equal(sound[:, 0], 0.0)
    assert np.abs(sound[:, 1:]).max() > 1.0
    engine = by_name("fused", "xla")
    vehicle = jax.device_get(scene.worlds.control.vehicle)
    start = quickly(partial(engine.reset, scene.spec))(scene.fleet, scene.worlds)
    step = quickly(partial(engine.segment, scene.spec, n_sample=1, steps_per_sample=2))
    after = jax.device_get(step(scene.fleet, scene.worlds, start)[0])
    thrust = after.vehicles.thrust[0, 0]
    given = np.zeros(6)
    for one, newton in enumerate(thrust if thrust.ndim == 1 else thrust[0]):
        given += np.float64(newton) * vehicle.B[0, 0][:, one]
    np.testing.assert_allclose(seen.wrench[0, 1, 0], given, rtol=1e-4, atol=1e-3)


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
    environment, vehicles = jax.device_get((scene.worlds.environment, scene.worlds.control.vehicle))
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
