"""What the network promises of teams: order, padding, place and heading of W change nothing."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_experiments.learned_planner import flow, network
from angler_experiments.learned_planner.scene import Scene, build_scene
from angler_experiments.learned_planner.shapes import NetworkSize
from angler_experiments.learned_planner.train import examples

pytestmark = pytest.mark.nightly(
    by="tests/experiments/learned_planner/test_plans.py, whose plans come of the shipped network"
)


@pytest.fixture(scope="module")
def params():
    fresh = network.init_params(jax.random.key(1), NetworkSize(units=16, blocks=2))
    leaves, tree = jax.tree.flatten(fresh)
    keys = jax.random.split(jax.random.key(2), len(leaves))
    # The last layer of a fresh network is zero, which would make everything equal.
    noisy = [
        leaf + 0.2 * jax.random.normal(key, leaf.shape)
        for leaf, key in zip(leaves, keys, strict=True)
    ]
    return jax.tree.unflatten(tree, noisy)


@pytest.fixture(scope="module")
def scene_of(made):
    return jax.tree.map(lambda leaf: leaf[0], made.scenes)


@pytest.fixture(scope="module")
def carried(params):
    @jax.jit
    def run(scene_of, begin):
        return flow.integrate_flow(params, network.encode_scene(params, scene_of), begin, 2)

    return run


def _ordered(scene_of: Scene, order) -> Scene:
    rows = {
        name: getattr(scene_of, name)[order] for name in ("gap", "own", "bodies", "water", "exists")
    }
    return replace(scene_of, others=scene_of.others[order][:, order], **rows)


def test_the_order_of_robots_changes_their_order_only(scene_of, carried):
    begin = flow.sample_noise(jax.random.key(0), 2, 4)
    order = np.array([2, 0, 3, 1])
    straight = carried(scene_of, begin)
    other = carried(_ordered(scene_of, order), begin[:, order])
    np.testing.assert_allclose(other, straight[:, order], atol=2e-5)
    assert np.abs(straight[:, order] - straight).max() > 0.1


def test_the_order_of_obstacles_changes_nothing(scene_of, carried):
    begin = flow.sample_noise(jax.random.key(0), 2, 4)
    back = replace(
        scene_of, bodies=scene_of.bodies[:, ::-1], body_exists=scene_of.body_exists[::-1]
    )
    np.testing.assert_allclose(carried(back, begin), carried(scene_of, begin), atol=2e-5)


def test_rows_that_do_not_exist_change_nothing(made, scene_of, carried):
    padded = jax.tree.map(lambda leaf: leaf[0], examples.pad_team(made, 6).scenes)
    padded = replace(
        padded,
        others=padded.others.at[:, 4:].set(7.0),
        bodies=jnp.where(padded.body_exists[:, None], padded.bodies, -3.0),
    )
    begin = flow.sample_noise(jax.random.key(0), 2, 6)
    assert begin.shape[1] == 6
    np.testing.assert_array_equal(begin[:, :4], flow.sample_noise(jax.random.key(0), 2, 4))
    np.testing.assert_allclose(
        carried(padded, begin)[:, :4], carried(scene_of, begin[:, :4]), atol=2e-5
    )


def test_other_robots_are_seen(scene_of, carried):
    begin = flow.sample_noise(jax.random.key(0), 2, 4)
    alone = replace(scene_of, exists=jnp.array([True, False, False, False]))
    gap = np.abs(carried(alone, begin)[:, 0] - carried(scene_of, begin)[:, 0])
    assert gap.max() > 1e-3


def test_the_loss_has_a_slope_where_there_are_no_obstacles(params, made):
    scenes = replace(made.scenes, body_exists=jnp.zeros_like(made.scenes.body_exists))
    slope = jax.jit(jax.grad(flow.loss))(
        params, scenes, made.encoded_paths, made.has_path, jax.random.key(0)
    )
    numbers = np.concatenate([np.ravel(leaf) for leaf in jax.tree.leaves(slope)])
    assert np.isfinite(numbers).all()
    assert np.abs(numbers).max() > 1e-3


def _moved(problem, turn, shift, cells):
    """A problem in a W that is turned by ``turn`` [3, 3] and then shifted."""

    def moved(p):
        return p @ turn.T + shift

    shape = np.array(problem.grid.occupied.shape) * np.asarray(problem.grid.cell_m)
    corners = np.stack([np.zeros(3), shape]) + np.asarray(problem.grid.origin_m)
    origin = moved(corners).min(axis=0)
    moving = problem.obstacles
    return replace(
        problem,
        grid=replace(problem.grid, occupied=cells, origin_m=jnp.asarray(origin, jnp.float32)),
        floor_z_m=problem.floor_z_m + shift[2],
        team=replace(
            problem.team,
            start_m=moved(problem.team.start_m),
            goal_m=moved(problem.team.goal_m),
        ),
        obstacles=replace(moving, p_m=moved(moving.p_m), velocity_mps=moving.velocity_mps @ turn.T),
    )


QUARTER = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], np.float32)
MIRROR = np.diag([1.0, -1.0, 1.0]).astype(np.float32)


@pytest.mark.parametrize(
    ("turn", "shift"),
    [(np.eye(3, dtype=np.float32), [3.0, -7.5, 2.0]), (QUARTER, [0.0, 0.0, 0.0])],
    ids=["shifted", "a quarter turned"],
)
def test_where_w_is_changes_nothing(planned, turn, shift):
    problem = jax.tree.map(lambda leaf: leaf[0], planned[1])
    rock = np.asarray(problem.grid.occupied)
    cells = np.rot90(rock, axes=(0, 1)) if turn is QUARTER else rock
    other = _moved(problem, turn, np.array(shift, np.float32), jnp.asarray(cells))
    scene_of = jax.jit(build_scene)
    here, there = scene_of(problem), scene_of(other)
    for name in ("gap", "own", "others", "bodies"):
        np.testing.assert_allclose(getattr(there, name), getattr(here, name), atol=3e-4)
    assert np.ptp(np.asarray(here.gap)) > 0.3


def test_mirrored_examples_are_those_of_the_mirrored_world(planned):
    worlds, problems = planned
    flat = _moved(
        jax.tree.map(lambda leaf: leaf[1], problems),
        MIRROR,
        np.zeros(3, np.float32),
        problems.grid.occupied[1][:, ::-1],
    )
    path = jax.tree.map(lambda leaf: leaf[1], worlds.path)
    path = replace(path, position_m=path.position_m @ MIRROR.T)
    make = jax.jit(examples.build_examples)
    there = make(*jax.tree.map(lambda leaf: leaf[None], (flat, path)))
    here = make(*jax.tree.map(lambda leaf: leaf[1:2], (problems, worlds.path)))
    for a, b in zip(
        jax.tree.leaves(examples.mirror_examples(here, jnp.array([True]))),
        jax.tree.leaves(there),
        strict=True,
    ):
        np.testing.assert_allclose(np.asarray(a, float), np.asarray(b, float), atol=2e-3)
    assert np.abs(np.asarray(here.encoded_paths[..., 1])).max() > 0.05
