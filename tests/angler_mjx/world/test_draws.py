"""What a world is drawn from: its key alone; cells, places, obstacles, current are independent."""

import jax
import numpy as np

from angler_mjx.world import sampling
from angler_mjx.world.config import resolve_world
from angler_mjx.world.generate import generate_batch
from angler_mjx.world.obstacles import BOX

from ..independence import assert_uncorrelated
from .recipe import COUNT, RADIUS, RECIPE, SEED


def columns(made):
    """Numbers of each group: its name -> [n, k], free of each other but for the drawing itself."""
    obstacles, current = made.obstacles, made.current
    kind, size, mass, volume, place, turn = (
        getattr(obstacles, name)[:, 1:]  # the first row is the explicit box
        for name in ("kind", "size_m", "mass_kg", "volume_m3", "p0", "q0")
    )
    cube = kind == BOX
    lift = mass / (1000.0 * volume) - 1.0
    turn = turn * np.sign(turn[..., :1])
    flat = len(made.valid), -1
    return {
        # The first walls that a key gives.
        "cell": made.grid.occupied[:, 0, 0, :4],
        "start": made.start_m.reshape(flat),
        "goal": made.goal_m[:, :, 2],
        "place": place.reshape(flat),
        "radius": np.where(cube, np.sqrt(3.0), 1.0) * size[..., 0],
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


def test_parts_of_a_world_are_independent(worlds):
    numbers, names = table(worlds)
    for robot in range(len(RADIUS)):
        # A goal keeps away from its own start, so each is judged with the starts of the others.
        own = [f"start {3 * robot + axis}" for axis in range(3)]
        others = [f"goal {other}" for other in range(len(RADIUS)) if other != robot]
        keep = [i for i, name in enumerate(names) if name not in own + others]
        assert_uncorrelated(numbers[:, keep], [names[i] for i in keep])


def test_neighbouring_worlds_and_seeds_are_independent(worlds):
    (numbers, names), (other, _) = (
        table(worlds),
        table(generate_batch(RECIPE, RADIUS, SEED + 1, 0, COUNT)),
    )
    for i, name in enumerate(names):
        here, before, there = numbers[1:, i], numbers[:-1, i], other[1:, i]
        assert_uncorrelated(
            np.stack([here, before, there], axis=1), [name, "the world before", "the other seed"]
        )


def test_a_world_alone_and_with_a_robot_less_is_the_same(worlds):
    """A batch goes through in tiles, the last of them filled up, and redraws some in groups."""
    tile = sampling.tile_size(resolve_world(RECIPE), len(RADIUS))
    assert COUNT // 2 < tile < COUNT
    again, late = (np.flatnonzero((worlds.redraws == n) & worlds.valid) for n in (1, 2))
    picked = [*range(30), *again[-15:], *late[-15:], COUNT // 2, COUNT // 2 + 1, COUNT - 1]
    alone = [generate_batch(RECIPE, RADIUS[:2], SEED, int(world), 1) for world in picked]
    few = jax.tree.map(lambda *leaves: np.concatenate(leaves), *alone)
    kept = jax.tree.map(lambda leaf: leaf[picked], worlds)
    # Where both fleets fitted at the same try: a world that is drawn again is another one.
    same = few.redraws == kept.redraws
    assert same.sum() > 0.9 * len(picked)
    few, kept = (jax.tree.map(lambda leaf: leaf[same], part) for part in (few, kept))
    assert set(kept.redraws) == {0, 1, 2}
    np.testing.assert_array_equal(few.grid.occupied, kept.grid.occupied)
    for name in ("start_m", "goal_m", "path_ratio", "line_free"):
        np.testing.assert_array_equal(getattr(few, name), getattr(kept, name)[:, :2])
    for a, b in zip(jax.tree.leaves(few.current), jax.tree.leaves(kept.current), strict=True):
        # 0.3 m/s in float32: the two programs may round differently.
        np.testing.assert_allclose(a, b, rtol=1e-6, atol=1e-6)
    for name in ("size_m", "kind", "q0", "mass_kg"):
        a, b = getattr(few.obstacles, name), getattr(kept.obstacles, name)
        np.testing.assert_allclose(a, b, rtol=1e-6)
    # A place changes only where the robot stands that is there or not.
    moved = np.any(np.abs(few.obstacles.p0 - kept.obstacles.p0)[:, 1:] > 1e-5, axis=-1)
    assert moved.mean() < 0.1
