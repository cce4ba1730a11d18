"""What a survey is to see, by loops over the cells; and viewpoints that see enough of it."""

import math
from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.world.rock.grid import Grid
from angler_mjx.world.tasks import surface, visibility
from angler_mjx.world.tasks.spec import SurveySpec

CELL = 1.5
SHAPE = (9, 8, 6)
JOBS = 40


def rocky(seed: int) -> np.ndarray:
    rock: np.ndarray = np.random.default_rng(seed).random(SHAPE) < 0.08
    return rock


def grid_of(rock: np.ndarray) -> Grid:
    origin = jnp.array([-6.0, -6.0, -12.0])
    return Grid(occupied=jnp.array(rock), origin_m=origin, cell_m=jnp.array(CELL))


def spec_of(of: str) -> SurveySpec:
    seen = visibility.build_footprint(math.radians(50.0), 5.0, CELL)
    return SurveySpec(of=of, footprint=seen, altitude_cells=2, coverage=0.9)  # type: ignore[arg-type]


@pytest.mark.parametrize("floor_cells", [0.0, 1.2])
def test_the_ground_is_the_lowest_free_cell_of_each_column(floor_cells: float) -> None:
    rock = rocky(1)
    rock[2, 3] = True
    grid = grid_of(rock)
    floor_z = float(grid.origin_m[2]) + floor_cells * CELL
    ground = np.asarray(surface.ground_cells(grid, jnp.array(floor_z)))
    for i in range(SHAPE[0]):
        for j in range(SHAPE[1]):
            free = [k for k in range(SHAPE[2]) if not rock[i, j, k] and k + 0.5 > floor_cells]
            assert ground[i, j] == (min(free) if free else SHAPE[2])


def test_surface_cells_are_free_and_border_on_what_is_surveyed() -> None:
    rock = rocky(2)
    grid = grid_of(rock)
    ground = surface.ground_cells(grid, grid.origin_m[2])
    found = {
        of: np.asarray(surface.surface_cells(spec_of(of), grid, ground))
        for of in ("floor", "rock", "both")
    }
    for cell in np.ndindex(*SHAPE):
        beside = [
            tuple(np.add(cell, step))
            for step in ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1))
        ]
        inside = [c for c in beside if all(0 <= a < n for a, n in zip(c, SHAPE, strict=True))]
        at_rock = not rock[cell] and any(rock[c] for c in inside)
        at_floor = not rock[cell] and all(rock[cell[0], cell[1], k] for k in range(cell[2]))
        assert found["rock"][cell] == at_rock
        assert found["floor"][cell] == at_floor
        assert found["both"][cell] == (at_rock or at_floor)


@pytest.mark.parametrize("of", ["floor", "both"])
def test_viewpoints_are_reachable_and_see_what_is_theirs_and_enough_together(of: str) -> None:
    spec, cover = spec_of(of), jax.jit(surface.choose_viewpoints, static_argnums=(0, 1))
    for seed in (3, 4):
        rock = rocky(seed)
        grid, reachable = grid_of(rock), ~rock
        reachable[:2] = False  # nobody gets there
        points, exists, fits, world = cover(
            spec, JOBS, 0.3, grid, grid.origin_m[2], jnp.array(reachable)
        )
        assert fits
        cells = np.asarray(world.cells)
        assert world.count == cells.sum() > 20
        assert not cells[rock].any()
        covered = np.zeros(SHAPE, bool)
        for p, there, mine in zip(points, exists, world.of_job, strict=True):
            cell = visibility.cell_of(grid, p)
            columns = np.asarray(visibility.window_columns(spec, SHAPE, cell))
            theirs = np.array(
                [
                    (*column, k)
                    for column, word in zip(columns, np.asarray(mine)[:, 0], strict=True)
                    for k in range(SHAPE[2])
                    if int(word) >> k & 1
                ]
            )
            assert len(theirs) == 0 or there
            if not there:
                continue
            assert reachable[tuple(np.asarray(cell))]
            assert not covered[tuple(theirs.T)].any()  # each cell is one job's alone
            covered[tuple(theirs.T)] = True
            way = np.asarray(visibility.centre_m(grid, jnp.array(theirs))) - np.asarray(p)
            length = np.linalg.norm(way, axis=1)
            assert (length <= 5.0 - 0.3 + 1e-4).all()
            assert (-way[:, 2] >= math.cos(math.radians(50.0)) * length - 1e-4).all()
        assert (covered <= cells).all()
        assert covered.sum() >= 0.95 * cells.sum() - 1  # half of what may be left out as well


@pytest.mark.parametrize("text", ["0.6", "0.95", "0.09", "0.123", "1.0", "0.9999"])
def test_the_required_cells_are_exact(text: str) -> None:
    """In single precision 0.6 of 25 cells are 15.000001, and 16 would be required."""
    total = np.r_[np.arange(0, 4000), 99_999, 1_000_000, 2**24]
    spec = SurveySpec(
        of="floor",
        footprint=visibility.build_footprint(1.0, 5.0, CELL),
        altitude_cells=2,
        coverage=float(text),
    )
    found = np.asarray(jax.jit(spec.required_cells)(jnp.array(total, jnp.int32)))
    assert found.tolist() == [math.ceil(Fraction(text) * int(n)) for n in total]


def test_viewpoints_are_chosen_from_512_candidates_at_most() -> None:
    """513 columns, and 513 cells of a lattice, are one too many."""
    for of, shape in (("floor", (27, 19, 1)), ("rock", (27, 19, 1)), ("both", (19, 14, 1))):
        reachable = jnp.ones(shape, bool)
        ground = jnp.zeros(shape[:2], jnp.int32)
        cells, _ = surface.candidate_cells(spec_of(of), reachable, ground)
        assert 64 <= len(cells) <= 512


def test_a_world_whose_viewpoints_see_too_little_has_no_room() -> None:
    rock = rocky(5)
    grid = grid_of(rock)
    cover = jax.jit(surface.choose_viewpoints, static_argnums=(0, 1))
    *_, fits, _ = cover(spec_of("floor"), 2, 0.3, grid, grid.origin_m[2], jnp.array(~rock))
    assert not fits
