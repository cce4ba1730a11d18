"""Where robots start and where they go: free, clear of each other, and reachable.

Starts and goals are centres of cells. All of them lie in one connected region of cells that the
widest robot of the fleet can pass, so every robot can reach its goal. Passable means: the sphere of
the robot's radius about the cell's centre meets no occupied cell, no explicit static obstacle, not
the floor and no face of the grid.
"""

import math
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from angler_kernels.caverns import largest_cavern
from angler_kernels.clearance import capsules_obstacle
from angler_mjx.errors import ConfigError
from angler_mjx.world.config import WorldRecipe
from angler_mjx.world.obstacle_explicit import explicit_rows
from angler_mjx.world.obstacles import STATIC, Obstacles

# Corner c is (bit 0 -> x, bit 1 -> y, bit 2 -> z). The first four are pairwise face diagonals and
# go to the other four, so up to four robots share no corner at all.
_CORNERS = (0b000, 0b011, 0b101, 0b110, 0b111, 0b100, 0b010, 0b001)
_JITTER_CELLS = {"cross": 3.0, "parallel": 1.0}
"""How much farther from its corner or lane a robot may stand than the nearest free cell."""


def cell_centres(recipe: WorldRecipe) -> jax.Array:
    """Centres of all cells, [nx, ny, nz, 3] m, W."""
    index = jnp.stack(jnp.meshgrid(*(jnp.arange(n) for n in recipe.shape), indexing="ij"), axis=-1)
    return jnp.array(recipe.origin_m, float) + recipe.cell_m * (index + 0.5)


def cell_clearance(occupied: jax.Array, cell_m: float) -> jax.Array:
    """Distance [nx, ny, nz] of each cell's centre to what is occupied or outside, m.

    Exact up to 1.5 cells and never more: cells two away are at least that far. A neighbour through
    a face, edge or corner is sqrt(1), sqrt(2), sqrt(3) half cells away.

    Args:
        occupied: bool [nx, ny, nz].
        cell_m: edge of a cell.
    """
    solid = jnp.pad(occupied, 1, constant_values=True)
    x, y, z = (_widen(solid, axis) for axis in range(3))
    xy, yz, zx = _widen(x, 1), _widen(y, 2), _widen(z, 0)
    near = (solid, x | y | z, xy | yz | zx, _widen(xy, 2))
    clearance = jnp.full(solid.shape, 1.5 * cell_m, float)
    for n_axis in (3, 2, 1, 0):
        clearance = jnp.where(near[n_axis], 0.5 * math.sqrt(n_axis) * cell_m, clearance)
    return clearance[1:-1, 1:-1, 1:-1]


def obstacle_gap(obstacles: Obstacles, points: jax.Array, only_static: bool) -> jax.Array:
    """Distance [...] of points [..., 3] to the nearest obstacle's surface at its start, m.

    Args:
        obstacles: of one world.
        points: [..., 3] m, W.
        only_static: leave out those that move.
    """
    gaps = jax.vmap(partial(_gaps, obstacles))(points.reshape(-1, 3))
    counts = obstacles.exists & ((obstacles.motion == STATIC) | (not only_static))
    return jnp.min(jnp.where(counts, gaps, jnp.inf), axis=1).reshape(points.shape[:-1])


def _gaps(obstacles: Obstacles, p: jax.Array) -> jax.Array:
    """Distance [n] of a point to each obstacle's surface at its start, m."""
    point, zero = p[None], jnp.zeros(1, p.dtype)
    to_one = partial(capsules_obstacle, point, point, zero, kinds=obstacles.kinds)
    return jax.vmap(to_one)(obstacles.p0, obstacles.q0, obstacles.kind, obstacles.size_m)


def check_given(recipe: WorldRecipe, radius_m: np.ndarray) -> None:
    """Refuse starts and goals of a file that lie outside the grid or touch an explicit obstacle.

    Args:
        recipe: with placement "given".
        radius_m: [n_robot].

    Raises:
        ConfigError: naming every such place.
    """
    if len(radius_m) != len(recipe.start_m):
        raise ConfigError(
            f"start_m and goal_m have {len(recipe.start_m)} places, the fleet has "
            f"{len(radius_m)} robots"
        )
    low = np.array(recipe.origin_m)
    high = low + recipe.size_m
    low[2] = max(low[2], recipe.floor_z_m)
    explicit = recipe.obstacles.explicit
    faults = []
    for key, places in (("start_m", recipe.start_m), ("goal_m", recipe.goal_m)):
        for i, place_m in enumerate(places):
            if np.any(place_m < low) or np.any(place_m > high):
                faults.append(f"{key}[{i}] = {place_m}: outside {low.tolist()} to {high.tolist()}")
            if not explicit:
                continue
            rows = explicit_rows(explicit, 1000.0)  # The water's density changes no shape.
            counts = (np.asarray(rows.motion) == STATIC) | (key == "start_m")
            gaps = np.asarray(_gaps(rows, jnp.array(place_m, float)))
            faults += [
                f"{key}[{i}] = {place_m}: {gaps[j]:.2f} m from obstacles.explicit[{j}]; "
                f"the robot's radius is {radius_m[i]:.2f} m"
                for j in np.flatnonzero(counts & (gaps < radius_m[i]))
            ]
    if faults:
        raise ConfigError("\n  ".join(["places that are not free", *faults]))


def place(
    recipe: WorldRecipe,
    centres: jax.Array,
    cavern: jax.Array,
    clearance: jax.Array,
    start_clearance: jax.Array,
    radius_m: jax.Array,
    key: jax.Array,
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Starts and goals of a fleet in one world.

    Robots are placed in order; each takes the best cell that is left. A goal is at least half the
    grid's longest edge away from its start.

    Args:
        recipe: static.
        centres: [nx, ny, nz, 3] centres of the cells, m, W.
        cavern: bool [nx, ny, nz] free cells, all connected.
        clearance: [nx, ny, nz] from each centre to all that stands still, m.
        start_clearance: [nx, ny, nz] from each centre to explicit obstacles that are there at the
            start, moving ones too, m.
        radius_m: [n_robot].
        key: random key of this world's placement.

    Returns:
        start [n_robot, 3], goal [n_robot, 3] (m, W) and whether the world holds the fleet [].
    """
    n_robot = radius_m.shape[0]
    open_cell = _open_cells(cavern, clearance >= jnp.max(radius_m)).ravel()
    if recipe.placement == "given":
        return _given(recipe, open_cell, start_clearance.ravel(), radius_m)
    point = centres.reshape(-1, 3).T
    noise_key, mirror_key = jax.random.split(key)
    # One field serves all robots: taking the least value left is drawing without putting back.
    noise = jax.random.uniform(noise_key, (2, point.shape[1]), jnp.float32)
    start_target, goal_target = _targets(recipe, n_robot, mirror_key)
    least_way = 0.5 * max(recipe.size_m)

    def place_one(
        gaps: tuple[jax.Array, jax.Array], robot: tuple[jax.Array, jax.Array, jax.Array]
    ) -> tuple[tuple[jax.Array, jax.Array], tuple[jax.Array, jax.Array, jax.Array]]:
        start_gap, goal_gap = gaps
        radius, near_start, near_goal = robot
        margin = radius + recipe.clearance_m
        free = open_cell & (start_gap >= margin)
        from_cell = jnp.argmin(
            jnp.where(free, _score(recipe, point, near_start, noise[0]), jnp.inf)
        )
        fits, start = free[from_cell], point[:, from_cell]
        way = _distance(point, start)
        free = open_cell & (goal_gap >= margin) & (way >= least_way)
        price = _score(recipe, point, near_goal, noise[1])
        to_cell = jnp.argmin(jnp.where(free, price, jnp.inf))
        fits, goal = fits & free[to_cell], point[:, to_cell]
        start_gap = jnp.minimum(start_gap, way - radius)
        goal_gap = jnp.minimum(goal_gap, _distance(point, goal) - radius)
        return (start_gap, goal_gap), (start, goal, fits)

    # Distance of each cell's centre to everything that a start, or a goal, must keep clear of.
    gaps = start_clearance.ravel(), jnp.full(point.shape[1], jnp.inf)
    _, (start, goal, fits) = jax.lax.scan(place_one, gaps, (radius_m, start_target, goal_target))
    return start, goal, jnp.all(fits)


def cell_of(recipe: WorldRecipe, p: jax.Array) -> jax.Array:
    """Index [..., 3] (int32) of the cell that holds a point [..., 3] m, W; the nearest if none."""
    index = jnp.floor((p - jnp.array(recipe.origin_m, p.dtype)) / recipe.cell_m)
    return jnp.clip(index.astype(jnp.int32), 0, jnp.array(recipe.shape) - 1)


def _open_cells(cavern: jax.Array, passable: jax.Array) -> jax.Array:
    """Largest connected region of the passable cells.

    Most fleets can pass every free cell, and those are connected already. The search is then given
    an empty grid, on which it ends at once; a branch would not save it, because in a batch both
    sides of a branch are computed.
    """
    whole = jnp.all(passable == cavern)
    return jnp.where(whole, passable, largest_cavern(passable & ~whole))


def _given(
    recipe: WorldRecipe, open_cell: jax.Array, start_clearance: jax.Array, radius_m: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """The places of the file; they hold where the cells that they lie in would be taken."""
    start, goal = jnp.array(recipe.start_m, float), jnp.array(recipe.goal_m, float)
    _, ny, nz = recipe.shape
    strides = jnp.array([ny * nz, nz, 1])
    from_cell = jnp.sum(cell_of(recipe, start) * strides, axis=-1)
    to_cell = jnp.sum(cell_of(recipe, goal) * strides, axis=-1)
    fits = open_cell[from_cell] & open_cell[to_cell] & (start_clearance[from_cell] >= radius_m)
    return start, goal, jnp.all(fits)


def _targets(recipe: WorldRecipe, n_robot: int, key: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Points [n_robot, 3] that the robots' starts and goals should be near to, m, W."""
    lo, size = jnp.array(recipe.origin_m, float), jnp.array(recipe.size_m, float)
    if recipe.placement == "parallel":
        columns = min(n_robot, max(1, recipe.shape[1] // 2))
        rows = -(-n_robot // columns)
        lane = [
            ((i % columns + 0.5) / columns, (i // columns + 0.5) / rows) for i in range(n_robot)
        ]
        y_z = jnp.array(lane, float)
        first = jnp.pad(y_z, ((0, 0), (1, 0)))
        return lo + size * first, lo + size * first.at[:, 0].set(1.0)
    corner = [_CORNERS[i % 8] for i in range(n_robot)]
    bits = jnp.array([[c & 1, c >> 1 & 1, c >> 2 & 1] for c in corner], bool)
    # Every world has its own corners: the pattern is mirrored along each axis or not.
    bits ^= jax.random.uniform(key, (3,), jnp.float32) < 0.5
    return lo + size * bits, lo + size * ~bits


def _score(recipe: WorldRecipe, point: jax.Array, target: jax.Array, noise: jax.Array) -> jax.Array:
    """What a robot pays for each cell, [cells]; the cheapest is taken."""
    if recipe.placement == "random":
        return noise
    jitter = _JITTER_CELLS[recipe.placement] * recipe.cell_m
    return _distance(point, target) + jitter * noise


def _distance(point: jax.Array, to: jax.Array) -> jax.Array:
    """Distances [cells] of points [3, cells] to one [3]."""
    x, y, z = (point[axis] - to[axis] for axis in range(3))
    return jnp.sqrt(x * x + y * y + z * z)


def _widen(solid: jax.Array, axis: int) -> jax.Array:
    """Each cell or one of its two neighbours along an axis; what lies beyond the array is free."""
    n = solid.shape[axis]
    pad = [(1, 1) if other == axis else (0, 0) for other in range(3)]
    padded = jnp.pad(solid, pad)
    before = jax.lax.slice_in_dim(padded, 0, n, axis=axis)
    after = jax.lax.slice_in_dim(padded, 2, n + 2, axis=axis)
    return before | solid | after
