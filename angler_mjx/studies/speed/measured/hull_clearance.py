"""Speed of the exact distance from a hull to the cells of a world, apart from all else.

A query is what a contact check does for one robot: look up the packed cells around its centre, and
the distance of its capsules to those that can be nearest. Every hull moves between two queries.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from angler_kernels.clearance import capsules_neighbours, cell_neighbours, neighbour_window
from angler_mjx.errors import RunError
from angler_mjx.robot.vehicles import library, params
from angler_mjx.studies.speed import flops
from angler_mjx.studies.speed.rows import (
    SpeedRow,
    check_repeats,
    iterate_turns,
    moved_bytes,
    peak_device_bytes,
    read_program_costs,
    seconds_of,
    summarise_rates,
)

SHAPE, CELL_M, DENSITY = (16, 16, 16), 1.5, 0.06
"""Of the reef."""
QUERIES, SHIFT_M = 20, 0.05
"""Of each hull in one call, and its way between two."""


def measure(*, worlds: int, robots: int, repeats: int) -> SpeedRow:
    """Time distances of BlueROV2 Heavy hulls at random poses to random cells.

    Args:
        worlds: in one device call, each with cells of its own.
        robots: hulls in each world.
        repeats: timed calls, after one that is not timed.

    Returns:
        Rates in queries/s.

    Raises:
        ConfigError: too few repeats.
        RunError: a distance is not finite, or does not change on the way.
    """
    check_repeats(repeats)
    vehicle = params.build_vehicle(library.load_vehicle("bluerov2_heavy"), None, 16.0)
    rng = np.random.default_rng(0)
    occupied = jax.jit(lambda key: jax.random.uniform(key, (worlds, *SHAPE)) < DENSITY)(
        jax.random.key(0)
    )
    cells = jax.jit(jax.vmap(lambda cells: cell_neighbours(cells).reshape(-1)))(occupied)
    size = np.array(SHAPE) * CELL_M
    centre = jnp.asarray(rng.uniform(0.1, 0.8, (worlds, robots, 3)) * size, jnp.float32)
    turn = jnp.asarray(np.linalg.qr(rng.normal(size=(worlds, robots, 3, 3)))[0], jnp.float32)
    capsules = (vehicle.capsule_a_m, vehicle.capsule_b_m, vehicle.capsule_r_m)

    def of_hull(cells: jax.Array, p: jax.Array, turn: jax.Array) -> tuple[jax.Array, jax.Array]:
        a, b, r = capsules
        ahead = turn[:, 0] * SHIFT_M

        def query(carry: Any, _: None) -> tuple[Any, None]:
            at, min_gap, max_gap = carry
            index, lo = neighbour_window(at, jnp.zeros(3), jnp.float32(CELL_M), SHAPE)
            ends = (at + _rotate_points(turn, a), at + _rotate_points(turn, b))
            gap = capsules_neighbours(*ends, r, at, lo, cells[index], jnp.float32(CELL_M))
            return (at + ahead, jnp.minimum(min_gap, gap), jnp.maximum(max_gap, gap)), None

        start = (p, jnp.full((), jnp.inf, p.dtype), jnp.full((), -jnp.inf, p.dtype))
        (_, min_gap, max_gap), _ = jax.lax.scan(query, start, length=QUERIES)
        return min_gap, max_gap

    of_world = jax.vmap(of_hull, (None, 0, 0))
    of_worlds = jax.jit(jax.vmap(of_world))
    lowered = of_worlds.lower(cells, centre, turn)
    compile_s, program = seconds_of(lowered.compile)
    total = worlds * robots * QUERIES
    rates = []
    for counts in iterate_turns(repeats):
        taken, (min_gap, max_gap) = seconds_of(program, cells, centre, turn)
        require_change(np.asarray(min_gap), np.asarray(max_gap))
        rates += [total / taken] * counts
    counted = flops.count_operations(of_worlds, cells, centre, turn)
    moved = moved_bytes(program)
    return SpeedRow(
        workload="clearance",
        inside=f"{QUERIES} queries of each hull: look-up of the cells, distance of its "
        f"{vehicle.capsule_r_m.shape[0]} capsules",
        worlds=worlds,
        robots=robots,
        unit="queries/s",
        **summarise_rates(rates),
        compile_s=compile_s,
        kernels="xla",
        flops=None if counted.flops is None else counted.flops / total,
        flops_from=counted.how,
        least_bytes=moved / total if moved else None,
        **read_program_costs(program),
        device_peak_bytes=peak_device_bytes(),
    )


def require_change(min_gap: np.ndarray, max_gap: np.ndarray) -> None:
    """Refuse distances that are not finite, or that are the same all the way.

    Args:
        min_gap: of each hull on its way, m.
        max_gap: greatest, m.

    Raises:
        RunError: they are.
    """
    if not (np.isfinite(min_gap).all() and np.isfinite(max_gap).all()):
        raise RunError("a timed distance is not finite: no number is given")
    # Hulls with nothing near see the greatest exact distance all the way; in a reef few do.
    if np.mean(max_gap > min_gap) < 0.5:
        raise RunError("most timed distances do not change on the way: no number is given")


def _rotate_points(turn: jax.Array, points: jax.Array) -> jax.Array:
    """Points [c, 3] turned by a matrix [3, 3], without a product of matrices."""
    return jnp.sum(turn[None] * points[:, None, :], axis=-1)
