"""Surface cells of a survey, and viewpoints that cover them.

Viewpoints are chosen greedily, each time the viewpoint with the most cells not yet seen: no other
rule of polynomial cost covers a set with much fewer (U. Feige, "A Threshold of ln n for
Approximating Set Cover", Journal of the ACM 45(4), 1998).
"""

import math

import jax
import jax.numpy as jnp
import numpy as np

from angler_kernels import bit_grid
from angler_mjx.world.rock.grid import Grid
from angler_mjx.world.tasks import visibility
from angler_mjx.world.tasks.spec import SurveySpec, SurveyWorld

MAX_CANDIDATES = 512
"""Max number of candidate viewpoints of a world."""
_DOWN = (0.0, 0.0, -1.0)


def ground_cells(grid: Grid, floor_z_m: jax.Array) -> jax.Array:
    """Return the lowest free cell int32 [nx, ny] of each column above the floor; nz if none."""
    nz = grid.occupied.shape[2]
    middle = grid.origin_m[2] + (jnp.arange(nz) + 0.5) * grid.cell_m
    free = ~grid.occupied & (middle > floor_z_m)
    return jnp.where(jnp.any(free, axis=2), jnp.argmax(free, axis=2), nz).astype(jnp.int32)


def surface_cells(spec: SurveySpec, grid: Grid, ground: jax.Array) -> jax.Array:
    """Return the free cells bool [nx, ny, nz] that border on the surveyed surface.

    For the floor, the lowest free cell of each column: it lies on the sea floor, or on the rock
    there. For rock, all free cells that share a face with a cell of rock.
    """
    rock, nz = grid.occupied, grid.occupied.shape[2]
    bordering = jnp.zeros_like(rock)
    if spec.of in ("floor", "both"):
        bordering |= jnp.arange(nz) == ground[..., None]
    if spec.of in ("rock", "both"):
        wide = jnp.pad(rock, 1)
        for axis in range(3):
            for begin in (0, 2):
                at = [1, 1, 1]
                at[axis] = begin
                end = [i + n for i, n in zip(at, rock.shape, strict=True)]
                bordering |= jax.lax.slice(wide, at, end)
    return bordering & ~rock


def candidate_cells(
    spec: SurveySpec, reachable: jax.Array, ground: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Return the candidate cells of viewpoints.

    Over each column of the floor the reachable cell whose height above it is nearest to the
    altitude; around rock a lattice. Both are thinned evenly to `MAX_CANDIDATES`.

    Returns:
        Cells int32 [n, 3], and bool [n] whether robots can reach them.
    """
    shape, cells, may = reachable.shape, [], []
    divisor = 2 if spec.of == "both" else 1
    if spec.of in ("floor", "both"):
        stride = math.ceil(math.sqrt(shape[0] * shape[1] * divisor / MAX_CANDIDATES))
        column = _lattice_points(shape[:2], max(1, stride))
        height = jnp.arange(shape[2]) - ground[column[:, 0], column[:, 1], None]
        free = reachable[column[:, 0], column[:, 1]] & (height >= 0)
        off = jnp.where(free, jnp.abs(height - spec.altitude_cells), shape[2] + 1)
        best = jnp.argmin(off, axis=1).astype(jnp.int32)
        cells.append(jnp.concatenate([column, best[:, None]], axis=1))
        may.append(jnp.any(free, axis=1))
    if spec.of in ("rock", "both"):
        stride = math.ceil((math.prod(shape) * divisor / MAX_CANDIDATES) ** (1 / 3))
        points = _lattice_points(shape, max(1, stride))
        cells.append(points)
        may.append(reachable[points[:, 0], points[:, 1], points[:, 2]])
    return jnp.concatenate(cells), jnp.concatenate(may)


def _lattice_points(shape: tuple[int, ...], stride: int) -> jax.Array:
    axes = [np.arange((stride - 1) // 2, n, stride) for n in shape]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, len(shape))
    return jnp.array(points, jnp.int32)


def choose_viewpoints(
    spec: SurveySpec,
    jobs: int,
    spare_m: float,
    grid: Grid,
    floor_z_m: jax.Array,
    reachable: jax.Array,
) -> tuple[jax.Array, jax.Array, jax.Array, SurveyWorld]:
    """Choose the viewpoints of one world.

    They also see half of the cells that the coverage may leave out, since the view from slightly
    beside a viewpoint differs. No more are taken than that needs.

    Args:
        spec: settings.
        jobs: max number of viewpoints, M.
        spare_m: distance from a viewpoint within which its cells must also be seen.
        grid: rock.
        floor_z_m: [] height of the floor.
        reachable: bool [nx, ny, nz] cells that robots can reach.

    Returns:
        Viewpoints [M, 3] in W, bool [M] whether they exist, bool [] whether they see enough, and
        the surface to see.
    """
    ground = ground_cells(grid, floor_z_m)
    surface = surface_cells(spec, grid, ground)
    cell, may = candidate_cells(spec, reachable, ground)
    point, down, packed = (
        visibility.centre_m(grid, cell),
        jnp.array(_DOWN),
        bit_grid.pack_grid(surface),
    )

    def from_one(p: jax.Array) -> tuple[jax.Array, jax.Array]:
        return visibility.seen_cells(spec, grid, packed, ground, p, down, spare_m)

    cells, sees = jax.vmap(from_one)(point)
    sees &= may[:, None]
    _, ny, nz = surface.shape
    flat = (cells[..., 0] * ny + cells[..., 1]) * nz + cells[..., 2]
    wanted = jnp.zeros(surface.size, bool).at[flat].max(sees)
    count = jnp.sum(wanted, dtype=jnp.int32)
    enough = jnp.ceil(0.5 * (1.0 + spec.coverage) * count).astype(jnp.int32)

    def choose(left: jax.Array, _: None) -> tuple[jax.Array, tuple[jax.Array, ...]]:
        new = sees & left[flat]
        gain = jnp.sum(new, axis=1, dtype=jnp.int32)
        best = jnp.argmax(gain)
        exists = (gain[best] > 0) & (count - jnp.sum(left, dtype=jnp.int32) < enough)
        job_cells = new[best] & exists
        return left.at[flat[best]].min(~job_cells), (best, exists, job_cells)

    left, (chosen, exists, job_cells) = jax.lax.scan(choose, wanted, length=jobs)
    fits = count - jnp.sum(left, dtype=jnp.int32) >= spec.required_cells(count)
    wanted = wanted.reshape(surface.shape)
    world = SurveyWorld(
        cells=wanted,
        words=bit_grid.pack_grid(wanted),
        ground=ground,
        of_job=visibility.pack_columns(spec, nz, cells[chosen, :, 2], job_cells),
        count=count,
    )
    return point[chosen], exists, fits & (count > 0), world
