"""The planner's lattice: cells packed into bits, the 26 moves between them, and the free space.

A grid [nx, ny, nz] becomes one 32-bit word per column (x, y), bit k for cell k along z, laid out in
one row with a guard word after every y-row and guard words at both ends. A step to a neighbour is
then one slice of the row and one bit shift, with no test for the border: guard words stay zero.
"""

import itertools
from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
import numpy as np

from angler_kernels.clearance import capsules_obstacle
from angler_mjx.errors import UnsupportedError
from angler_mjx.planning.path_search.bodies import StillObstacles
from angler_mjx.world.rock.grid import Grid

MAX_NZ = 32
"""Cells along z that fit in a word."""
_REACH = 3
"""Cells that the distance to rock looks away; distances end at (_REACH + 1/2) cells."""


@dataclass(frozen=True)
class Edge:
    """A line between two cells of one block of 1, 2 or 3 axes, in both directions."""

    near: tuple[int, int, int]
    """Corner of the block, 0 or 1 per axis, where it begins."""
    far: tuple[int, int, int]
    """The opposite corner."""
    block: tuple[int, int, int]
    """1 for each axis the block spans."""

    @property
    def axes(self) -> int:
        """Number of axes of the block: its length is sqrt(axes) cells."""
        return sum(self.block)

    @property
    def layers(self) -> int:
        """Number of layers: sqrt(1, 2, 3) cells at half a cell a layer, rounded up."""
        return self.axes + 1


def _build_edges() -> tuple[Edge, ...]:
    edges = []
    for step in itertools.product((-1, 0, 1), repeat=3):
        if step > (0, 0, 0):
            x, y, z = step
            near = (max(-x, 0), max(-y, 0), max(-z, 0))
            far = (max(x, 0), max(y, 0), max(z, 0))
            edges.append(Edge(near=near, far=far, block=(abs(x), abs(y), abs(z))))
    return tuple(sorted(edges, key=lambda edge: edge.axes))


EDGES = _build_edges()
"""The 13 undirected edges, shortest first."""
BLOCKS = tuple(dict.fromkeys(edge.block for edge in EDGES))
"""The 7 kinds of block; the middle of a block is the middle of every edge across it."""


@dataclass(frozen=True)
class LatticeLayout:
    """Where the word of column (i, j) of a grid stands: guard + i row + j."""

    shape: tuple[int, int, int]

    @property
    def row(self) -> int:
        """Words from one x to the next."""
        return self.shape[1] + 1

    @property
    def guard_size(self) -> int:
        """Number of guard words at each end."""
        return self.row + 1

    @property
    def inner(self) -> int:
        """Number of words between the guards at the ends."""
        return self.shape[0] * self.row

    @property
    def total(self) -> int:
        """Number of all words."""
        return self.inner + 2 * self.guard_size

    def pad(self, inner: jax.Array) -> jax.Array:
        """Put the guards around words [inner]; [total]."""
        return jnp.pad(inner, self.guard_size)

    def pack_cells(self, cells: jax.Array) -> jax.Array:
        """Pack cells bool [nx, ny, nz] into words [total]."""
        columns = jnp.pad(column_bits(cells), ((0, 0), (0, 1)))
        return self.pad(columns.reshape(self.inner))

    def shift_to_neighbour(self, packed: jax.Array, dx: int, dy: int, dz: int) -> jax.Array:
        """Return the bits of each cell's neighbour (dx, dy, dz), words [inner]."""
        at = self.guard_size + dx * self.row + dy
        neighbours = packed[at : at + self.inner]
        if dz > 0:
            return neighbours >> dz
        return neighbours << -dz if dz < 0 else neighbours

    def column_centres(self, grid: Grid) -> tuple[jax.Array, jax.Array]:
        """Return x and y [total] of the centre of each word's column, m."""
        n = np.arange(self.total) - self.guard_size
        x = grid.origin_m[0] + (n // self.row + 0.5) * grid.cell_m
        y = grid.origin_m[1] + (n % self.row + 0.5) * grid.cell_m
        return x, y


def column_bits(cells: jax.Array) -> jax.Array:
    """Pack cells bool [nx, ny, nz] into one word per column, uint32 [nx, ny].

    Raises:
        UnsupportedError: the grid is higher than a word has bits.
    """
    if cells.shape[2] > MAX_NZ:
        raise UnsupportedError(
            f"the grid planner takes at most {MAX_NZ} cells along z, this grid has {cells.shape[2]}"
        )
    weight = np.uint32(1) << np.arange(cells.shape[2], dtype=np.uint32)
    return jnp.sum(jnp.where(cells, weight, jnp.uint32(0)), axis=2, dtype=jnp.uint32)


def span_bits(lo: jax.Array, hi: jax.Array) -> jax.Array:
    """Return words with bits lo..hi (integers, any size) set; none where hi < lo."""
    low, high = jnp.clip(lo, 0, 31).astype(jnp.uint32), jnp.clip(hi, 0, 31).astype(jnp.uint32)
    bits = (jnp.uint32(2) << high) - (jnp.uint32(1) << low)
    return jnp.where((lo <= hi) & (hi >= 0) & (lo <= 31), bits, jnp.uint32(0))


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Terrain:
    """Map of one world: all that does not move."""

    grid: Grid
    columns: jax.Array
    """uint32 [nx, ny] the occupied cells."""
    gap_m: jax.Array
    """[nx, ny, nz] distance from a cell's centre to rock, faces of the cube and floor."""
    obstacles: StillObstacles | None
    """None where the world can have none."""
    edge_gap_m: jax.Array | None
    """[13, nx, ny, nz] least distance of the edge in the block whose lowest corner is this cell to
    a static obstacle; None where the world can have none."""
    cell_gap_m: jax.Array | None
    """[nx, ny, nz] the same for the cell's centre."""
    layout: LatticeLayout = field(metadata={"static": True})


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class FreeSpace:
    """Where one robot may be and go, as words."""

    cells: jax.Array
    """uint32 [total] cells whose centre is clear."""
    edges: jax.Array
    """uint32 [13, total] edges that are clear, at the lowest corner of their block."""


def build_terrain(grid: Grid, floor_z_m: jax.Array, obstacles: StillObstacles | None) -> Terrain:
    """Build the map that all robots of one world share.

    Args:
        grid: rock.
        floor_z_m: [] height of the sea floor, m.
        obstacles: still ones; None for none.
    """
    shape = grid.occupied.shape
    layout = LatticeLayout(shape=(shape[0], shape[1], shape[2]))
    centre = _cell_centres(grid, layout.shape)
    floor = centre[..., 2] - floor_z_m
    cell_gap = edge_gap = None
    if obstacles is not None:
        cell_gap = _obstacle_gap(obstacles, centre, centre)
        near = jnp.array([edge.near for edge in EDGES]) * grid.cell_m
        far = jnp.array([edge.far for edge in EDGES]) * grid.cell_m
        edge_gap = jax.vmap(lambda a, b: _obstacle_gap(obstacles, centre + a, centre + b))(
            near, far
        )
    return Terrain(
        grid=grid,
        columns=column_bits(grid.occupied),
        gap_m=jnp.minimum(_rock_gap(grid), floor),
        obstacles=obstacles,
        cell_gap_m=cell_gap,
        edge_gap_m=edge_gap,
        layout=layout,
    )


def free_space(land: Terrain, clearance_m: jax.Array) -> FreeSpace:
    """Return cells and edges that keep ``clearance_m`` [] from all that does not move.

    An edge is free where all cells of its block are: the distance from rock to any point of the
    block's inside is least at one of its cells' centres, because rock is made of the same cells.
    """
    layout = land.layout
    clear = land.gap_m >= clearance_m
    if land.cell_gap_m is not None:
        clear &= land.cell_gap_m >= clearance_m
    cells = layout.pack_cells(clear)
    blocks = {}
    for block in BLOCKS:
        free = layout.shift_to_neighbour(cells, 0, 0, 0)
        for corner in itertools.product(*(range(n + 1) for n in block)):
            free &= layout.shift_to_neighbour(cells, *corner)
        blocks[block] = free
    inner = jnp.stack([blocks[edge.block] for edge in EDGES])
    edges = jax.vmap(layout.pad)(inner)
    if land.edge_gap_m is not None:
        edges &= jax.vmap(layout.pack_cells)(land.edge_gap_m >= clearance_m)
    return FreeSpace(cells=cells, edges=edges)


def line_of_sight(land: Terrain, a: jax.Array, b: jax.Array, clearance_m: jax.Array) -> jax.Array:
    """Return whether the segment from a [3] to b [3] keeps ``clearance_m`` from all still bodies.

    Rock is grown by the clearance along each axis, so that near its corners and edges the test asks
    for up to sqrt(3) times more than it must. The segment is clipped to each grown column; the
    cells that it meets there are those its z-range covers. Faces and floor are not looked at: they
    are planes, so a segment is clear of them where its ends are.

    Returns:
        bool [].
    """
    cell, origin = land.grid.cell_m, land.grid.origin_m
    # A direction of zero cannot be divided by; 1e-6 m moves the segment by nothing that counts.
    d = jnp.where(jnp.abs(b - a) < 1e-6, 1e-6, b - a)
    enter, leave = [], []
    for axis in (0, 1):
        low = origin[axis] + cell * jnp.arange(land.columns.shape[axis]) - a[axis]
        ends = jnp.stack([low - clearance_m, low + cell + clearance_m]) / d[axis]
        enter.append(jnp.min(ends, axis=0))
        leave.append(jnp.max(ends, axis=0))
    s_in = jnp.maximum(jnp.maximum(enter[0][:, None], enter[1][None, :]), 0.0)
    s_out = jnp.minimum(jnp.minimum(leave[0][:, None], leave[1][None, :]), 1.0)
    z_in, z_out = a[2] + s_in * d[2], a[2] + s_out * d[2]
    low_z = (jnp.minimum(z_in, z_out) - clearance_m - origin[2]) / cell
    high_z = (jnp.maximum(z_in, z_out) + clearance_m - origin[2]) / cell
    # Held to the word before the cast: empty intervals reach to infinity.
    met = span_bits(
        jnp.floor(jnp.clip(low_z, -1.0, 32.0)).astype(jnp.int32),
        jnp.floor(jnp.clip(high_z, -1.0, 32.0)).astype(jnp.int32),
    )
    clear = ~jnp.any((s_in <= s_out) & ((met & land.columns) != 0))
    if land.obstacles is not None:
        clear &= _obstacle_gap(land.obstacles, a, b) >= clearance_m
    return clear


def _cell_centres(grid: Grid, shape: tuple[int, int, int]) -> jax.Array:
    """Return the centres [nx, ny, nz, 3], m."""
    index = jnp.stack(jnp.meshgrid(*(jnp.arange(n) for n in shape), indexing="ij"), axis=-1)
    return grid.origin_m + (index + 0.5) * grid.cell_m


def _rock_gap(grid: Grid) -> jax.Array:
    """Return distances [nx, ny, nz] from cell centres to the nearest rock or face of the cube.

    Squared distance to boxes of the same grid is a sum over the axes, so its minimum is taken one
    axis after the other.
    """
    solid = jnp.pad(grid.occupied, _REACH, constant_values=True)
    far = (_REACH + 0.5) ** 2
    square = jnp.where(solid, 0.0, far).astype(grid.cell_m.dtype)
    for axis in range(3):
        inner = square.shape[axis] - 2 * _REACH
        parts = [
            jax.lax.slice_in_dim(square, _REACH + k, _REACH + k + inner, axis=axis)
            + max(abs(k) - 0.5, 0.0) ** 2
            for k in range(-_REACH, _REACH + 1)
        ]
        square = jnp.stack(parts).min(axis=0)
    return jnp.sqrt(jnp.minimum(square, far)) * grid.cell_m


def _obstacle_gap(obstacles: StillObstacles, a: jax.Array, b: jax.Array) -> jax.Array:
    """Return the least distance [...] of segments a to b [..., 3] to the still obstacles, m."""
    if a.ndim > 1:
        return jax.vmap(lambda start, end: _obstacle_gap(obstacles, start, end))(a, b)

    def gap_to_obstacle(p: jax.Array, q: jax.Array, kind: jax.Array, size: jax.Array) -> jax.Array:
        axis_radius = jnp.zeros((1,), a.dtype)
        return capsules_obstacle(
            a[None], b[None], axis_radius, p, q, kind, size, kinds=obstacles.kinds
        )

    gap = jax.vmap(gap_to_obstacle)(
        obstacles.p_m, obstacles.q, obstacles.kind, obstacles.half_size_m
    )
    return jnp.min(jnp.where(obstacles.exists, gap, jnp.inf))
