import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.world.acoustics.shadow import CUT_DB, RockLoss, rock_between_m
from angler_mjx.world.rock.grid import Grid


@pytest.fixture(scope="module")
def wall():
    """8 x 8 x 4 cells of 1.5 m from (-6, -6, -10) up, with a wall of two cells across x = 0."""
    occupied = np.zeros((8, 8, 4), bool)
    occupied[3:5, :6] = True
    return Grid(
        occupied=jnp.asarray(occupied),
        origin_m=jnp.array([-6.0, -6.0, -10.0]),
        cell_m=jnp.array(1.5),
    )


def test_straight_through_a_wall(wall):
    a, b = jnp.array([-5.0, 0.1, -7.0]), jnp.array([5.0, 0.1, -7.0])
    assert rock_between_m(wall, a, b) == pytest.approx(3.0, abs=1.5)
    assert rock_between_m(wall, b, a) == pytest.approx(float(rock_between_m(wall, a, b)), abs=1e-5)


def test_length_is_right_on_the_mean(wall):
    """Against steps of a millimetre along many ways, in numpy."""
    rng = np.random.default_rng(0)
    ends = rng.uniform([-5.9, -5.9, -9.9], [5.9, 5.9, -4.1], (40, 2, 3))
    share = (np.arange(12_000) + 0.5) / 12_000
    errors = []
    for a, b in ends:
        way = a + share[:, None] * (b - a)
        cell = np.floor((way - [-6.0, -6.0, -10.0]) / 1.5).astype(int)
        exact = np.linalg.norm(b - a) * np.mean(np.asarray(wall.occupied)[tuple(cell.T)])
        errors.append(float(rock_between_m(wall, jnp.array(a), jnp.array(b))) - exact)
    assert np.abs(errors).max() < 1.5
    assert abs(np.mean(errors)) < 0.15


def test_beside_above_and_outside_there_is_none(wall):
    for a, b in (
        ([-5.0, 5.0, -7.0], [5.0, 5.0, -7.0]),  # by the gap
        ([-5.0, 0.0, -2.0], [5.0, 0.0, -2.0]),  # over it
        ([-5.0, 0.0, -7.0], [-4.0, 3.0, -7.0]),  # on one side
        ([50.0, 0.0, -7.0], [60.0, 0.0, -7.0]),
        ([1.0, 1.0, -30.0], [1.0, 1.0, -20.0]),
    ):
        assert rock_between_m(wall, jnp.array(a), jnp.array(b)) == 0.0


def test_rock_cuts_or_damps(wall):
    a, b = jnp.array([-5.0, 0.1, -7.0]), jnp.array([5.0, 0.1, -7.0])
    assert RockLoss(db_per_m=None).loss_db(wall, a, b) == CUT_DB
    within = float(rock_between_m(wall, a, b))
    assert RockLoss(db_per_m=2.0).loss_db(wall, a, b) == pytest.approx(2.0 * within)
    assert RockLoss(db_per_m=None).loss_db(wall, a, a + jnp.array([0.0, 1.0, 0.0])) == 0.0
