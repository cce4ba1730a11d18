"""What a world is drawn from: cells, places, obstacles and current are independent."""

import jax
import numpy as np
import pytest

from angler_mjx.files import parse
from angler_mjx.world.config import WorldConfig
from angler_mjx.world.generate import generate_batch
from angler_mjx.world.obstacles import BOX

from ..independence import assert_uncorrelated

N = 2000
RADIUS = np.array([0.4, 0.4, 0.4])
SALT = {"type": "automaton", "die_below": 0, "born_above": 26, "steps": 0}
CONFIG = parse(
    WorldConfig,
    {
        "preset": "reef",
        "shape": [8, 8, 6],
        # Walls as they were drawn, and so few that robots and obstacles can be nearly anywhere.
        "rule": SALT,
        "fill": 0.15,
        "placement": "random",
        "currents": [
            {"type": "gauss_markov", "max_speed_mps": 0.3, "vertical_share": 1.0},
            {"type": "gauss_markov", "max_speed_mps": 0.3, "vertical_share": 1.0},
            {"type": "vortices", "count": 2, "peak_speed_mps": [0.1, 0.3]},
        ],
        "obstacles": {
            "dynamic": {
                "count": 2,
                "cube_share": 0.5,
                "rise_share": 0.3,
                "sink_share": 0.3,
                "vertical_speed_mps": [0.1, 0.2],
            }
        },
    },
    source="test",
)


def worlds(n_robot=3, seed=7, count=N):
    return jax.tree.map(
        np.asarray, generate_batch(CONFIG, RADIUS[:n_robot], seed, 0, count, horizon_s=20.0)
    )


@pytest.fixture(scope="module")
def drawn():
    return worlds()


def columns(made):
    """Numbers of each group: its name -> [n, k], free of each other but for the drawing itself."""
    obstacles, current = made.obstacles, made.current
    cube = obstacles.kind == BOX
    lift = obstacles.mass_kg / (1000.0 * obstacles.volume_m3) - 1.0
    turn = obstacles.q0 * np.sign(obstacles.q0[..., :1])
    flat = len(made.valid), -1
    return {
        # The first walls that a key gives.
        "cell": made.grid.occupied[:, 0, 0, :4],
        "start": made.start_m.reshape(flat),
        "goal": made.goal_m[:, :, 2],
        "place": obstacles.p0.reshape(flat),
        "radius": np.where(cube, np.sqrt(3.0), 1.0) * obstacles.size_m[..., 0],
        "cube": cube,
        "rises": np.sign(np.where(np.abs(lift) < 1e-5, 0.0, lift)),
        "turn": turn[..., 1:].reshape(flat),
        "wander": current[0].knots_mps[:, 0],
        "wander too": current[1].knots_mps[:, 0],
        "vortex": current[2].centre_m.reshape(flat),
        "sense": np.sign(current[2].circulation_m2ps),
        "core": current[2].core_m,
    }


def table(made):
    """All columns side by side, and the name of each."""
    found = columns(made)
    names = [f"{group} {i}" for group, rows in found.items() for i in range(rows.shape[1])]
    return np.concatenate(list(found.values()), axis=1).astype(float), names


def test_parts_of_a_world_are_independent(drawn):
    assert drawn.valid.all()
    numbers, names = table(drawn)
    for robot in range(len(RADIUS)):
        # A goal keeps away from its own start, so each is judged with the starts of the others.
        own = [f"start {3 * robot + axis}" for axis in range(3)]
        others = [f"goal {other}" for other in range(len(RADIUS)) if other != robot]
        keep = [i for i, name in enumerate(names) if name not in own + others]
        assert_uncorrelated(numbers[:, keep], [names[i] for i in keep])


def test_neighbouring_worlds_and_seeds_are_independent(drawn):
    (numbers, names), (other, _) = table(drawn), table(worlds(seed=8))
    for i, name in enumerate(names):
        here, before, there = numbers[1:, i], numbers[:-1, i], other[1:, i]
        assert_uncorrelated(
            np.stack([here, before, there], axis=1), [name, "the world before", "the other seed"]
        )


def test_a_robot_more_changes_nothing_for_the_others(drawn):
    few = worlds(n_robot=2, count=64)
    # Where both fleets fitted at the same try: a world that is drawn again is another one.
    same = few.redraws == drawn.redraws[:64]
    assert same.sum() > 50
    kept = jax.tree.map(lambda leaf: leaf[:64][same], drawn)
    few = jax.tree.map(lambda leaf: leaf[same], few)
    np.testing.assert_array_equal(few.grid.occupied, kept.grid.occupied)
    for name in ("start_m", "goal_m", "path_ratio", "line_free"):
        np.testing.assert_array_equal(getattr(few, name), getattr(kept, name)[:, :2])
    for a, b in zip(jax.tree.leaves(few.current), jax.tree.leaves(kept.current), strict=True):
        # 0.3 m/s in float32: the two programs may round differently.
        np.testing.assert_allclose(a, b, atol=1e-6)
    for name in ("size_m", "kind", "q0", "mass_kg"):
        a, b = getattr(few.obstacles, name), getattr(kept.obstacles, name)
        np.testing.assert_allclose(a, b, rtol=1e-6)
    # A place changes only where the new robot stands in it.
    moved = np.any(np.abs(few.obstacles.p0 - kept.obstacles.p0) > 1e-5, axis=-1)
    assert moved.mean() < 0.1
