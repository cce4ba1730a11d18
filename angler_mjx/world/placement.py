"""Placement of robots' starts and goals: free, clear of each other, and reachable.

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

from angler_kernels.bit_grid import pack_grid, shift_grid, unpack_grid
from angler_kernels.caverns import largest_cavern
from angler_kernels.clearance import capsules_obstacle
from angler_mjx.errors import ConfigError
from angler_mjx.sampling import fold_keys, uniform_rows
from angler_mjx.world.config import WorldRecipe
from angler_mjx.world.obstacles import STATIC, Obstacles
from angler_mjx.world.obstacles.explicit import find_gaps_m

# Corner c is (bit 0 -> x, bit 1 -> y, bit 2 -> z). The first four are pairwise face diagonals and
# go to the other four, so up to four robots share no corner at all.
_CORNERS = (0b000, 0b011, 0b101, 0b110, 0b111, 0b100, 0b010, 0b001)
_JITTER_CELLS = {"cross": 3.0, "parallel": 1.0}
"""Max extra distance, in cells, from a robot's corner or lane beyond the nearest free cell."""


def cell_centres(recipe: WorldRecipe) -> jax.Array:
    """Return the centres of all cells, [nx, ny, nz, 3] m, W; bitwise equal in every program."""
    axes = (
        jnp.array(low + recipe.cell_m * (np.arange(n) + 0.5), float)
        for low, n in zip(recipe.origin_m, recipe.shape, strict=True)
    )
    return jnp.stack(jnp.meshgrid(*axes, indexing="ij"), axis=-1)


def passable_cells(
    free: jax.Array, ground: jax.Array, cell_m: float, radius_m: jax.Array
) -> jax.Array:
    """Return the cells at whose centre a sphere meets no occupied cell, face of the grid or ground.

    A neighbour through a face, edge or corner is sqrt(1), sqrt(2), sqrt(3) half cells away; cells
    two away are irrelevant for a radius below 1.5 cells.

    Args:
        free: packed cells, [nx, ny, words, n_world].
        ground: [nx, ny, nz] distance of each centre to floor and static obstacles, m.
        cell_m: edge of a cell.
        radius_m: [n_world] radius of the sphere; below 1.5 cells.

    Returns:
        Packed cells, as ``free``.
    """
    keep = partial(_erode_axis, nz=ground.shape[2])
    x, y, z = (keep(free, axis) for axis in range(3))
    xy, yz, zx = keep(x, 1), keep(y, 2), keep(z, 0)
    passable = free & pack_grid(ground[..., None] >= radius_m)
    for n_axis, clear in ((1, x & y & z), (2, xy & yz & zx), (3, keep(xy, 2))):
        fits = radius_m <= 0.5 * math.sqrt(n_axis) * cell_m
        passable = jnp.where(fits, passable, passable & clear)
    return passable


def obstacle_gap(obstacles: Obstacles, points: jax.Array, only_static: bool) -> jax.Array:
    """Return distances [...] of points [..., 3] to the nearest obstacle's surface at its start, m.

    Args:
        obstacles: obstacles of one world.
        points: [..., 3] m, W.
        only_static: leave out moving obstacles.
    """
    gaps = jax.vmap(partial(_obstacle_gaps, obstacles))(points.reshape(-1, 3))
    counts = obstacles.exists & ((obstacles.motion == STATIC) | (not only_static))
    return jnp.min(jnp.where(counts, gaps, jnp.inf), axis=1).reshape(points.shape[:-1])


def _obstacle_gaps(obstacles: Obstacles, p: jax.Array) -> jax.Array:
    """Return the distance [n] of a point to each obstacle's surface at its start, m."""
    point, zero = p[None], jnp.zeros(1, p.dtype)
    to_one = partial(capsules_obstacle, point, point, zero, kinds=obstacles.kinds)
    return jax.vmap(to_one)(obstacles.p0, obstacles.q0, obstacles.kind, obstacles.size_m)


def check_positions(
    recipe: WorldRecipe, radius_m: np.ndarray, *, by_end_effector: bool = False, held: int = -1
) -> None:
    """Refuse starts and goals of a file that lie outside the grid or touch an explicit obstacle.

    Args:
        recipe: recipe with placement "given".
        radius_m: [n_robot].
        by_end_effector: goals are those of end effectors, which need no room for a hull.
        held: index of the explicit obstacle that the robots hold by their arms; -1 for none.

    Raises:
        ConfigError: naming every such position.
    """
    if len(radius_m) != len(recipe.start_m):
        raise ConfigError(
            f"start_m and goal_m have {len(recipe.start_m)} places, the fleet has "
            f"{len(radius_m)} robots: give a place to each"
        )
    low = np.array(recipe.origin_m)
    high = low + recipe.size_m
    low[2] = max(low[2], recipe.floor_z_m)
    explicit = recipe.obstacles.explicit
    faults = []
    for key, positions in (("start_m", recipe.start_m), ("goal_m", recipe.goal_m)):
        room_m = np.zeros_like(radius_m) if by_end_effector and key == "goal_m" else radius_m
        for i, position_m in enumerate(positions):
            if np.any(position_m < low) or np.any(position_m > high):
                faults.append(
                    f"{key}[{i}] = {position_m}: outside {low.tolist()} to {high.tolist()}"
                )
            if not explicit:
                continue
            # In numpy: every file is checked, and JAX would compile each operation for that.
            gaps = np.concatenate(
                [
                    find_gaps_m(item, np.subtract(position_m, item.position_m)[None])
                    for item in explicit
                ]
            )
            counts = np.array([item.motion.type == "static" for item in explicit])
            counts |= key == "start_m"
            counts &= np.arange(len(counts)) != held
            faults += [
                f"{key}[{i}] = {position_m}: {gaps[j]:.2f} m from obstacles.explicit[{j}]; "
                f"the robot's radius is {radius_m[i]:.2f} m"
                for j in np.flatnonzero(counts & (gaps < room_m[i]))
            ]
    if faults:
        raise ConfigError("\n  ".join(["places that are not free", *faults]))


def choose_positions(
    recipe: WorldRecipe,
    clearance_m: jax.Array | float,
    free: jax.Array,
    passable: jax.Array,
    start_gap: jax.Array,
    radius_m: jax.Array,
    keys: jax.Array,
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Choose starts and goals of fleets, one fleet for each world.

    Robots are placed in order; each takes the best remaining cell. A goal is at least half the
    grid's longest edge away from its start.

    Args:
        recipe: static.
        clearance_m: [] free water between robots at their starts and goals.
        free: packed cells, [nx, ny, words, n_world], all connected.
        passable: packed cells, those of ``free`` that the widest robot can pass.
        start_gap: [nx, ny, nz] distance from each centre to explicit obstacles at the start, also
            moving ones, m.
        radius_m: [n_robot, n_world].
        keys: [n_world] random key of each world's placement.

    Returns:
        start and goal [n_robot, 3, n_world] (m, W), and whether the world holds the fleet
        [n_world].
    """
    n_robot = radius_m.shape[0]
    nz = recipe.shape[2]
    open_cell = unpack_grid(passable if recipe.is_empty else _open_cells(free, passable, nz), nz)
    open_cell = open_cell.reshape(-1, open_cell.shape[-1])
    if recipe.placement == "given":
        return _fixed_positions(recipe, open_cell, start_gap.ravel(), radius_m)
    point = cell_centres(recipe).reshape(-1, 3).T[..., None]

    def at_random(key: jax.Array) -> tuple[jax.Array, ...]:
        of_noise, *others = fold_keys(key, 3)
        # One field serves all robots: the least remaining value is a sample without replacement.
        noise = jax.random.uniform(of_noise, (2, point.shape[1]), jnp.float32)
        mirror, rotation = uniform_rows(jnp.stack(others), max(3, n_robot), jnp.float32)
        rotation = jnp.where(jnp.arange(n_robot) > 0, rotation[:n_robot], 0.0)
        return noise, rotation, *_target_points(recipe, n_robot, mirror[:3] < 0.5)

    noise, rotation, *targets = jax.vmap(at_random, out_axes=-1)(keys)
    min_length = 0.5 * max(recipe.size_m)

    def choose_one(
        gaps: tuple[jax.Array, jax.Array], robot: tuple[jax.Array, ...]
    ) -> tuple[tuple[jax.Array, jax.Array], tuple[jax.Array, jax.Array, jax.Array]]:
        start_gap, goal_gap = gaps
        radius, turned, near_start, near_goal = robot
        margin = radius + clearance_m
        may = open_cell & (start_gap >= margin)
        start, fits = _cheapest_cell(
            may, _cell_cost(recipe, point, near_start, noise[0], turned), point
        )
        distance = _point_distance(point, start)
        may = open_cell & (goal_gap >= margin) & (distance >= min_length)
        goal, fits_too = _cheapest_cell(
            may, _cell_cost(recipe, point, near_goal, noise[1], turned), point
        )
        start_gap = jnp.minimum(start_gap, distance - radius)
        goal_gap = jnp.minimum(goal_gap, _point_distance(point, goal) - radius)
        return (start_gap, goal_gap), (start, goal, fits & fits_too)

    # Distance of each cell's centre to everything that a start, or a goal, must keep clear of.
    far = jnp.full(open_cell.shape, jnp.inf)
    gaps = jnp.minimum(start_gap.reshape(-1, 1), far), far
    _, (start, goal, fits) = jax.lax.scan(choose_one, gaps, (radius_m, rotation, *targets))
    return start, goal, jnp.all(fits, axis=0)


def cell_of(recipe: WorldRecipe, p: jax.Array) -> jax.Array:
    """Return the index [..., 3] (int32) of the cell nearest to a point [..., 3] m, W."""
    index = jnp.floor((p - jnp.array(recipe.origin_m, p.dtype)) / recipe.cell_m)
    return jnp.clip(index.astype(jnp.int32), 0, jnp.array(recipe.shape) - 1)


def _open_cells(free: jax.Array, passable: jax.Array, nz: int) -> jax.Array:
    """Return the largest connected region of the passable cells, packed.

    Most fleets can pass every free cell, and those are connected already. The search then gets an
    empty grid, on which it ends at once.
    """
    whole = jnp.all(passable == free, axis=(0, 1, 2))
    return jnp.where(whole, passable, largest_cavern(jnp.where(whole, 0, passable), nz))


def _fixed_positions(
    recipe: WorldRecipe, open_cell: jax.Array, start_gap: jax.Array, radius_m: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return the positions of the file; they are accepted where their cells would be."""
    start, goal = jnp.array(recipe.start_m, float), jnp.array(recipe.goal_m, float)
    _, ny, nz = recipe.shape
    strides = jnp.array([ny * nz, nz, 1])
    from_cell = jnp.sum(cell_of(recipe, start) * strides, axis=-1)
    to_cell = jnp.sum(cell_of(recipe, goal) * strides, axis=-1)
    apart = start_gap[from_cell, None] >= radius_m
    fits = open_cell[from_cell] & open_cell[to_cell] & apart
    start, goal = (
        jnp.broadcast_to(p[..., None], (*p.shape, radius_m.shape[1])) for p in (start, goal)
    )
    return start, goal, jnp.all(fits, axis=0)


def _cheapest_cell(
    may: jax.Array, price: jax.Array, point: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Return the centre [3, n_world] of the cheapest allowed cell [cells, n_world], and if any is.

    Two plain minima, of the price and of the index among the cheapest, are vectorised; an argmin is
    not.
    """
    price = jnp.where(may, price, jnp.inf)
    lowest = jnp.min(price, axis=0)
    index = jnp.arange(may.shape[0], dtype=jnp.int32)[:, None]
    first = jnp.min(jnp.where(price == lowest, index, may.shape[0] - 1), axis=0)
    return point[:, first, 0], jnp.isfinite(lowest)


def _target_points(
    recipe: WorldRecipe, n_robot: int, mirrored: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Return target points [n_robot, 3] of the robots' starts and goals, m, W.

    Args:
        recipe: static.
        n_robot: static.
        mirrored: bool [3] whether the pattern of corners is mirrored along each axis.
    """
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
    bits ^= mirrored  # Every world has its own corners.
    return lo + size * bits, lo + size * ~bits


def _cell_cost(
    recipe: WorldRecipe, point: jax.Array, target: jax.Array, noise: jax.Array, turned: jax.Array
) -> jax.Array:
    """Return a robot's cost of each cell, [cells, n_world]; the cheapest is taken.

    With random placement each robot counts the field from its own value, ``turned`` [n_world]. If
    all began at 0, a cell refused to one robot, near its start, would go to the next robot.
    """
    if recipe.placement == "random":
        return (noise + turned) % 1.0
    jitter = _JITTER_CELLS[recipe.placement] * recipe.cell_m
    return _point_distance(point, target) + jitter * noise


def _point_distance(point: jax.Array, to: jax.Array) -> jax.Array:
    """Return distances [cells, n_world] of points [3, cells, 1] to a point [3, n_world] each."""
    x, y, z = (point[axis] - to[axis] for axis in range(3))
    return jnp.sqrt(x * x + y * y + z * z)


def _erode_axis(free: jax.Array, axis: int, nz: int) -> jax.Array:
    """Return the cells that are free with both neighbours along an axis; outside is not free."""
    return free & shift_grid(free, axis, 1, nz) & shift_grid(free, axis, -1, nz)
