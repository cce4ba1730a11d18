"""Visibility: cells of the grid in a cone of limited range, with free lines of sight.

A line of sight is free when none of the cells that it crosses is rock. These cells follow from its
crossings of the planes between cells, so all are looked up at once. Only the cells of a window
about the robot's own cell are checked.
"""

import math

import jax
import jax.numpy as jnp
import numpy as np

from angler_kernels.bit_grid import WORD
from angler_mjx.world.rock.grid import Grid
from angler_mjx.world.tasks.spec import Footprint, SurveySpec

_PARALLEL = 1e-6
"""Offset below which a line counts as crossing no plane along an axis, in cells."""

_UNROLLED = 8
"""Number of windows that a GPU unites in one kernel."""


def build_footprint(half_angle_rad: float, range_m: float, cell_m: float) -> Footprint:
    """Return a footprint, with its max reach in cells from anywhere in a cell of ``cell_m``."""
    sideways = 1.0 if half_angle_rad >= math.pi / 2 else math.sin(half_angle_rad)
    upwards = max(0.0, -math.cos(half_angle_rad))
    # From anywhere in a cell to another's centre; half a cell is gained at either end.
    cells = [math.floor(fraction * range_m / cell_m + 0.5) for fraction in (sideways, 1.0, upwards)]
    wide, down, up = cells
    return Footprint(
        half_angle_rad=half_angle_rad,
        range_m=range_m,
        wide=wide,
        down=down,
        up=up if upwards else 0,
    )


def window_cells(
    spec: SurveySpec, shape: tuple[int, ...], ground: jax.Array, cell: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Return the cells of the window about a cell.

    Args:
        spec: settings.
        shape: shape of the grid.
        ground: int32 [nx, ny] lowest free cell of each column.
        cell: int32 [3] the middle.

    Returns:
        Cells int32 [n, 3], and bool [n] whether they are in the grid; cells outside are clipped
        to it. For a survey of the floor only, one cell a column.
    """
    seen = spec.footprint
    side, last = np.arange(-seen.wide, seen.wide + 1), jnp.array(shape, jnp.int32) - 1
    tall = np.zeros(1, int) if spec.of == "floor" else np.arange(-seen.down, seen.up + 1)
    step = np.stack(np.meshgrid(side, side, tall, indexing="ij"), -1).reshape(-1, 3)
    cells = cell + jnp.array(step, jnp.int32)
    if spec.of == "floor":
        column = jnp.clip(cells[:, :2], 0, last[:2])
        cells = cells.at[:, 2].set(ground[column[:, 0], column[:, 1]])
    inside = jnp.all((cells >= 0) & (cells <= last), axis=-1)
    return jnp.clip(cells, 0, last), inside


def window_columns(spec: SurveySpec, shape: tuple[int, ...], cell: jax.Array) -> jax.Array:
    """Return columns int32 [c, 2] of the window about a cell int32 [3], in `window_cells` order."""
    side = np.arange(-spec.footprint.wide, spec.footprint.wide + 1)
    step = np.stack(np.meshgrid(side, side, indexing="ij"), -1).reshape(-1, 2)
    last = jnp.array(shape[:2], jnp.int32) - 1
    return jnp.clip(cell[:2] + jnp.array(step, jnp.int32), 0, last)


def pack_columns(spec: SurveySpec, nz: int, height: jax.Array, which: jax.Array) -> jax.Array:
    """Return cells of windows as bits along z of their columns.

    Args:
        spec: settings.
        nz: cells of the grid along z.
        height: int32 [k, n] third coordinate of the cells of k windows, from `window_cells`.
        which: bool [k, n] cells to pack; none outside the grid.

    Returns:
        Words uint32 [k, c, w] of the columns, in the order of `window_columns`.
    """
    side = 2 * spec.footprint.wide + 1
    height, which = (x.reshape(len(x), side * side, -1, 1) for x in (height, which))
    word = jnp.arange(-(-nz // WORD), dtype=jnp.int32)
    bit = jnp.uint32(1) << (height % WORD).astype(jnp.uint32)
    # Cells of a column are distinct, so the sum of their bits is their union.
    column_bits = jnp.where(which & (height // WORD == word), bit, jnp.uint32(0))
    return jnp.sum(column_bits, axis=2, dtype=jnp.uint32)


def union_windows(
    spec: SurveySpec, shape: tuple[int, ...], cell: jax.Array, words: jax.Array
) -> jax.Array:
    """Return the union of the windows about several cells.

    Args:
        spec: settings.
        shape: shape of the grid.
        cell: int32 [k, 3] centre cells of the windows.
        words: uint32 [k, c, w] words of their columns, as returned by `pack_columns`.

    Returns:
        Packed grid uint32 [nx, ny, w].
    """
    wide, (nx, ny, _) = spec.footprint.wide, shape
    side = 2 * wide + 1

    # Each column of the grid looks up its own bits, window after window: to write from each
    # window, or to compare all its columns with those of the grid, costs several times as much.
    def add(grid: jax.Array, window: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, None]:
        middle, words = window
        x = jnp.arange(nx)[:, None] - middle[0] + wide
        y = jnp.arange(ny) - middle[1] + wide
        inside = (x >= 0) & (x < side) & (y >= 0) & (y < side)
        added = words[jnp.where(inside, x * side + y, 0)]
        return grid | jnp.where(inside[..., None], added, jnp.uint32(0)), None

    nothing = jnp.zeros((nx, ny, words.shape[-1]), jnp.uint32)
    return jax.lax.scan(add, nothing, (cell, words), unroll=min(_UNROLLED, len(cell)))[0]


def window_size(spec: SurveySpec) -> int:
    """Return the number n of cells of a window."""
    seen = spec.footprint
    columns = (2 * seen.wide + 1) ** 2
    return columns if spec.of == "floor" else columns * (seen.down + seen.up + 1)


def cell_of(grid: Grid, p: jax.Array) -> jax.Array:
    """Return the cell int32 [..., 3] of p [..., 3] in W; the nearest cell if outside the grid."""
    last = jnp.array(grid.occupied.shape) - 1
    cell = jnp.floor((p - grid.origin_m) / grid.cell_m).astype(jnp.int32)
    return jnp.clip(cell, 0, last)


def centre_m(grid: Grid, cell: jax.Array) -> jax.Array:
    """Return the centre [..., 3] m in W of a cell int32 [..., 3]."""
    return grid.origin_m + (cell + 0.5) * grid.cell_m


def in_cone(
    seen: Footprint, p: jax.Array, down: jax.Array, at_m: jax.Array, spare_m: float = 0.0
) -> jax.Array:
    """Return whether points lie in the cone and range of a footprint, bool [...].

    Args:
        seen: the footprint.
        p: [3] position of the robot, in W.
        down: [3] its downward axis in W, of length 1.
        at_m: [..., 3] points in W.
        spare_m: distance from p within which the points must lie in the footprint from everywhere.
    """
    offset = at_m - p
    near = jnp.sum(offset * offset, axis=-1) <= (seen.range_m - spare_m) ** 2
    if seen.half_angle_rad < math.pi - 1e-3:
        # A cone with its apex moved ahead by this lies in all cones moved by spare_m.
        offset = offset - down * (spare_m / math.sin(seen.half_angle_rad))
        length = jnp.sqrt(jnp.sum(offset * offset, axis=-1))
        near &= jnp.sum(offset * down, axis=-1) >= math.cos(seen.half_angle_rad) * length
    return near


def is_free(
    seen: Footprint, grid: Grid, p: jax.Array, cells: jax.Array, wanted: jax.Array
) -> jax.Array:
    """Return whether lines from p [3] in W to centres of cells int32 [n, 3] are free, bool [n].

    The cell of p is not checked.

    Args:
        seen: a footprint whose window holds the cells.
        grid: rock.
        p: [3] in W.
        cells: int32 [n, 3].
        wanted: bool [n] requested cells; the result for others is undefined.
    """
    begin = (p - grid.origin_m) / grid.cell_m
    direction = cells + 0.5 - begin
    last = jnp.array(grid.occupied.shape, jnp.int32) - 1
    free = jnp.ones(cells.shape[0], bool)
    for axis, max_cells in enumerate((seen.wide, seen.wide, max(seen.down, seen.up))):
        along = direction[:, axis]
        forward = along > 0.0
        first = jnp.floor(begin[axis]).astype(jnp.int32)
        number = jnp.arange(max_cells, dtype=jnp.int32)[:, None]
        plane = jnp.where(forward, first + 1 + number, first - number)
        slow = jnp.abs(along) < _PARALLEL
        fraction = (plane - begin[axis]) / jnp.where(slow, 1.0, along)
        at = jnp.floor(begin + fraction[..., None] * direction).astype(jnp.int32)
        entered = jnp.where(forward, plane, plane - 1)
        at = jnp.clip(at.at[..., axis].set(entered), 0, last)
        # All others read the same cell, which costs a GPU almost nothing.
        at = jnp.where(wanted[:, None], at, 0)
        rock = grid.occupied[at[..., 0], at[..., 1], at[..., 2]]
        free &= ~jnp.any(rock & ~slow & (fraction < 1.0), axis=0)
    return free


def seen_cells(
    spec: SurveySpec,
    grid: Grid,
    wanted: jax.Array,
    ground: jax.Array,
    p: jax.Array,
    down: jax.Array,
    spare_m: float = 0.0,
) -> tuple[jax.Array, jax.Array]:
    """Return the requested cells that a robot sees.

    Args:
        spec: settings.
        grid: rock.
        wanted: uint32 [nx, ny, w] free cells, packed along z.
        ground: int32 [nx, ny] lowest free cell of each column.
        p: [3] position of the robot, in W.
        down: [3] its downward axis in W, of length 1.
        spare_m: as in `in_cone`.

    Returns:
        Cells int32 [n, 3] of the window about it, and bool [n] whether it sees them.
    """
    cells, inside = window_cells(spec, grid.occupied.shape, ground, cell_of(grid, p))
    x, y, z = cells[:, 0], cells[:, 1], cells[:, 2]
    sees = inside & (wanted[x, y, z // WORD] >> (z % WORD).astype(jnp.uint32) & 1 == 1)
    sees &= in_cone(spec.footprint, p, down, centre_m(grid, cells), spare_m)
    return cells, sees & is_free(spec.footprint, grid, p, cells, sees)
