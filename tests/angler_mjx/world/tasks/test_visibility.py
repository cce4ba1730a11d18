"""What robots see, against points taken densely along every line, and plain geometry."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_kernels import bit_grid
from angler_mjx.world.rock.grid import Grid
from angler_mjx.world.tasks import visibility
from angler_mjx.world.tasks.spec import SurveySpec

CELL, ORIGIN = 1.5, np.array([-4.5, -6.0, -9.0])
SHAPE = (6, 8, 5)
STEPS = 4001


def rocky(seed: int, share: float) -> np.ndarray:
    rock: np.ndarray = np.random.default_rng(seed).random(SHAPE) < share
    return rock


def grid_of(rock: np.ndarray) -> Grid:
    return Grid(occupied=jnp.array(rock), origin_m=jnp.array(ORIGIN, float), cell_m=jnp.array(CELL))


def spec_of(half_deg: float, range_m: float, of: str = "both") -> SurveySpec:
    seen = visibility.build_footprint(math.radians(half_deg), range_m, CELL)
    return SurveySpec(of=of, footprint=seen, altitude_cells=2, coverage=0.9)  # type: ignore[arg-type]


def free_by_points(rock: np.ndarray, p: np.ndarray, cell: np.ndarray) -> bool | None:
    """Whether no point of a line lies in rock; None where it grazes an edge of a cell."""
    end = (cell + 0.5) - (p - ORIGIN) / CELL
    points = (p - ORIGIN) / CELL + np.linspace(0, 1, STEPS)[:, None] * end
    off = np.abs(points - np.round(points))
    if np.any(np.sort(off, axis=1)[:, 1] < 3.0 / STEPS * np.abs(end).max() + 1e-3):
        return None
    at = np.floor(points).astype(int)
    begun = np.any(at != at[0], axis=1)
    return not np.any(rock[tuple(at[begun].T)])


def test_lines_of_sight_are_those_of_points_along_them() -> None:
    rock, spec = rocky(3, 0.2), spec_of(180.0, 5.0)
    random = np.random.default_rng(4)
    grid, told = grid_of(rock), 0
    wanted, ground = ~rock, jnp.zeros(SHAPE[:2], jnp.int32)
    look = jax.jit(
        lambda p: visibility.seen_cells(
            spec,
            grid,
            bit_grid.pack_grid(jnp.array(wanted)),
            ground,
            p,
            jnp.array([0.0, 0.0, -1.0]),
        )
    )
    for _ in range(12):
        start = np.argwhere(~rock)[random.integers(np.sum(~rock))]
        p = ORIGIN + (start + random.uniform(0.05, 0.95, 3)) * CELL
        cells, sees = (np.asarray(x) for x in look(jnp.array(p)))
        seen = {tuple(c) for c, s in zip(cells, sees, strict=True) if s}
        for cell in np.argwhere(wanted):
            centre = ORIGIN + (cell + 0.5) * CELL
            apart = np.linalg.norm(centre - p)
            if abs(apart - 5.0) < 1e-3:
                continue
            free = free_by_points(rock, p, cell)
            if free is None:
                continue
            told += 1
            assert (tuple(cell) in seen) == (free and apart < 5.0)
    assert told > 500


@pytest.mark.parametrize("half_deg", [45.0, 130.0])
def test_the_window_holds_all_cells_in_the_cone(half_deg: float) -> None:
    rock = np.zeros(SHAPE, bool)
    spec, grid = spec_of(half_deg, 4.0), grid_of(rock)
    random = np.random.default_rng(6)
    down = jnp.array([0.0, 0.0, -1.0])
    ground, everywhere = jnp.zeros(SHAPE[:2], jnp.int32), bit_grid.full_grid(SHAPE)
    look = jax.jit(lambda p: visibility.seen_cells(spec, grid, everywhere, ground, p, down))
    for _ in range(6):
        p = ORIGIN + random.uniform(0.02, 0.98, 3) * CELL * np.array(SHAPE)
        cells, sees = look(jnp.array(p))
        seen = {tuple(c) for c, s in zip(np.asarray(cells), np.asarray(sees), strict=True) if s}
        way = ORIGIN + (np.argwhere(~rock) + 0.5) * CELL - p
        length = np.linalg.norm(way, axis=1)
        angle = np.degrees(np.arccos(np.clip(-way[:, 2] / length, -1, 1)))
        inside = (length <= 4.0) & (angle <= half_deg)
        sure = (np.abs(length - 4.0) > 1e-3) & (np.abs(angle - half_deg) > 0.05)
        for cell, is_in, is_sure in zip(np.argwhere(~rock), inside, sure, strict=True):
            if is_sure:
                assert (tuple(cell) in seen) == is_in


@pytest.mark.parametrize("half_deg", [30.0, 120.0])
def test_what_is_seen_with_something_to_spare_is_seen_from_beside_too(half_deg: float) -> None:
    seen = spec_of(half_deg, 6.0).footprint
    random = np.random.default_rng(7)
    at, down = jnp.array(random.uniform(-6, 6, (20_000, 3))), jnp.array([0.0, 0.0, -1.0])
    sure = np.asarray(visibility.in_cone(seen, jnp.zeros(3), down, at, 0.7))
    assert 50 < sure.sum() < 15_000
    from_there = jax.jit(lambda p: visibility.in_cone(seen, p, down, at))
    for _ in range(20):
        beside = random.normal(size=3)
        beside *= 0.699 / np.linalg.norm(beside)
        there = np.asarray(from_there(jnp.array(beside)))
        assert there[sure].all()


def test_what_lies_in_several_windows_is_put_together() -> None:
    spec, random = spec_of(60.0, 4.0), np.random.default_rng(9)
    shape, wide = (6, 8, 40), spec.footprint.wide
    side, robots = 2 * wide + 1, 3
    cell = random.integers(0, shape, (robots, 3))
    cell[0] = (0, 7, 3)  # its window reaches out of the grid
    words = random.integers(0, 2**32, (robots, side * side, 2), dtype=np.uint64).astype(np.uint32)
    found = visibility.union_windows(spec, shape, jnp.array(cell), jnp.array(words))
    expected = np.zeros((*shape[:2], 2), np.uint32)
    for robot, i, j in np.ndindex(robots, side, side):
        x, y = cell[robot, :2] + (i - wide, j - wide)
        if 0 <= x < shape[0] and 0 <= y < shape[1]:
            expected[x, y] |= words[robot, i * side + j]
    np.testing.assert_array_equal(found, expected)
