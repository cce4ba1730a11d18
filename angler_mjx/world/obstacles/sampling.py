"""Obstacles of one world from tables and a key: explicit rows first, then sampled ones.

Sampled obstacles are placed one after another. Each tries a fixed number of random positions and
takes the first free one: clear of cells, of explicit obstacles, of the points to keep clear, and of
obstacles already placed. If none is clear of obstacles already placed, the position with the least
overlap is taken; if none is clear of the others, the row is left out (``exists = False``).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Self

import jax
import jax.numpy as jnp

from angler_kernels.clearance import capsules_obstacle, point_grid
from angler_kernels.rows import write_row
from angler_mjx.host_arrays import as_numbers
from angler_mjx.robot.vehicles.properties import GRAVITY_MPS2
from angler_mjx.sampling import UniformRange, fold_keys, uniform_rows
from angler_mjx.world.obstacles import bodies
from angler_mjx.world.obstacles.config import DynamicConfig, ExplicitConfig
from angler_mjx.world.obstacles.explicit import explicit_rows
from angler_mjx.world.obstacles.types import (
    BOX,
    DRIFT,
    SPHERE,
    Obstacles,
    bounding_radius,
)
from angler_mjx.world.rock.grid import Grid

_TRIES = 64


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class DriftingSampler:
    """Numbers of a `DynamicConfig` with obstacles.

    Programs take its leaves as arguments: other sizes or fractions need no compilation.
    """

    count: int = field(metadata={"static": True})
    kinds: tuple[int, ...] = field(metadata={"static": True})
    """Shapes that can occur."""
    radius_m: UniformRange
    cube_fraction: jax.Array
    """[]."""
    rise_fraction: jax.Array
    """[]."""
    moving_fraction: jax.Array
    """[] of those that rise or sink."""
    vertical_speed_mps: UniformRange

    @classmethod
    def of(cls, config: DynamicConfig) -> Self | None:
        """Return the numbers of a table (host side); None without obstacles."""
        if config.count == 0:
            return None
        possible = {SPHERE: config.cube_fraction < 1, BOX: config.cube_fraction > 0}
        return cls(
            count=config.count,
            kinds=tuple(kind for kind, occurs in possible.items() if occurs),
            radius_m=UniformRange.between(*config.radius_m),
            cube_fraction=as_numbers(config.cube_fraction),
            rise_fraction=as_numbers(config.rise_fraction),
            moving_fraction=as_numbers(config.rise_fraction + config.sink_fraction),
            vertical_speed_mps=UniformRange.between(*config.vertical_speed_mps),
        )


def sample_obstacles(
    listed: Sequence[ExplicitConfig],
    drifting: DriftingSampler | None,
    key: jax.Array,
    grid: Grid,
    bounds_lo: jax.Array,
    bounds_hi: jax.Array,
    keep_out_m: jax.Array,
    keep_out_radius_m: jax.Array | float,
    water_density: jax.Array | float,
    gravity: jax.Array | float = GRAVITY_MPS2,
) -> Obstacles:
    """Sample the obstacles of one world: explicit ones first, then sampled ones; at least one row.

    Args:
        listed: explicit obstacles of a file; static.
        drifting: sampled obstacles; None without them.
        key: random key of this world's obstacles.
        grid: static cells; sampled obstacles must be smaller in radius than a cell.
        bounds_lo: [3] lower corner of the region that obstacles stay in, m, W.
        bounds_hi: [3] upper corner.
        keep_out_m: [k, 3] points to keep clear of (starts and goals), m, W.
        keep_out_radius_m: [k] or [] distance to keep from each to an obstacle's surface, m.
        water_density: [] kg/m^3.
        gravity: [] m/s^2, converts rise and sink speeds into masses.
    """
    explicit = explicit_rows(listed, water_density) if listed else None
    if drifting is None:
        return _empty_row(water_density) if explicit is None else explicit
    bodies_key, position_key = fold_keys(key, 2)
    sampled = _sample_drifting(drifting, bodies_key, water_density, gravity)

    def distances(p: jax.Array) -> jax.Array:
        away = jnp.sqrt(jnp.sum((keep_out_m - p) ** 2, axis=1)) - keep_out_radius_m
        gap, _ = point_grid(p, grid.occupied, grid.origin_m, grid.cell_m)
        gap = jnp.minimum(gap, jnp.min(away, initial=jnp.inf))
        return gap if explicit is None else jnp.minimum(gap, _gap_to(explicit, p))

    radius = jax.vmap(bounding_radius)(sampled.kind, sampled.size_m)
    where = jax.random.uniform(position_key, (drifting.count, _TRIES, 3))
    inset = radius[:, None, None]
    lo, hi = bounds_lo + inset, bounds_hi - inset
    tries = lo + where * jnp.maximum(hi - lo, 0.0)
    p0, exists = _choose_positions(
        tries, jax.vmap(jax.vmap(distances))(tries) - radius[:, None], radius
    )
    sampled = replace(sampled, p0=p0, exists=exists)
    return sampled if explicit is None else _concatenate_rows(explicit, sampled)


def _sample_drifting(
    numbers: DriftingSampler,
    key: jax.Array,
    density: jax.Array | float,
    gravity: jax.Array | float,
) -> Obstacles:
    """Sample rows of drifting spheres and cubes, all at the origin."""
    n = numbers.count
    keys = fold_keys(key, 5)
    size, shape, tendency, speed = uniform_rows(keys[:4], n)
    rises = tendency < numbers.rise_fraction
    sinks = ~rises & (tendency < numbers.moving_fraction)
    up = jnp.where(rises, 1.0, jnp.where(sinks, -1.0, 0.0))
    turn = jax.random.normal(keys[4], (n, 4))
    return _build_bodies(
        numbers.radius_m.scale(size),
        shape < numbers.cube_fraction,
        up * numbers.vertical_speed_mps.scale(speed),
        turn / jnp.sqrt(jnp.sum(turn * turn, axis=1, keepdims=True)),
        density,
        gravity,
        numbers.kinds,
    )


def _empty_row(density: jax.Array | float) -> Obstacles:
    """Return a row with exists = False, for worlds without obstacles."""
    one, upright = jnp.ones(1), jnp.eye(1, 4)
    row = _build_bodies(one, jnp.zeros(1, bool), 0.0 * one, upright, density, GRAVITY_MPS2, ())
    return replace(row, exists=jnp.zeros(1, bool), motions=())


def _build_bodies(
    scale: jax.Array,
    cube: jax.Array,
    rise: jax.Array,
    q0: jax.Array,
    density: jax.Array | float,
    gravity: jax.Array | float,
    kinds: tuple[int, ...],
) -> Obstacles:
    """Return rows of drifting spheres and cubes.

    Every coefficient of a shape scales with a power of its size, so the shapes of bounding radius 1
    m are scaled. A body that rises at v is lighter than its displaced water by its drag at v over
    gravity.

    Args:
        scale: [n] bounding radius, m.
        cube: bool [n] True for a cube, False for a sphere.
        rise: [n] rise speed, negative where the body sinks, m/s.
        q0: [n, 4] attitude.
        density: [] density of the water, kg/m^3.
        gravity: [] m/s^2.
        kinds: shapes that can occur.
    """
    n = scale.shape[0]
    half = 1.0 / math.sqrt(3.0)
    ball, die = bodies.build_sphere(1.0), bodies.build_box((half, half, half))

    def pick(of_sphere: object, of_cube: object, power: jax.Array) -> jax.Array:
        unit = jnp.where(cube[:, None], jnp.asarray(of_cube, float), jnp.asarray(of_sphere, float))
        return unit * scale[:, None] ** power

    powers = jnp.array([3, 3, 3, 5, 5, 5])
    volume = pick([ball.volume_m3], [die.volume_m3], jnp.array([3]))[:, 0]
    D_q = 0.5 * density * pick(ball.drag, die.drag, powers - jnp.array([1, 1, 1, 0, 0, 0]))
    mass = density * volume - D_q[:, 2] * rise * jnp.abs(rise) / gravity
    size = pick([1.0, 0.0, 0.0], [half] * 3, jnp.ones(3, jnp.int32))
    return Obstacles(
        kind=jnp.where(cube, BOX, SPHERE).astype(jnp.int32),
        size_m=size,
        motion=jnp.full(n, DRIFT, jnp.int32),
        path=jnp.zeros((n, 8)),
        p0=jnp.zeros((n, 3)),
        q0=q0,
        nu0=jnp.zeros((n, 6)),
        mass_kg=mass,
        inertia_kgm2=mass[:, None] * pick(ball.inertia_m2, die.inertia_m2, jnp.full(3, 2)),
        volume_m3=volume,
        M_A=density * pick(ball.added, die.added, powers),
        D_l=jnp.zeros((n, 6)),
        D_q=D_q,
        exists=jnp.ones(n, bool),
        kinds=kinds,
        motions=(DRIFT,),
    )


def _gap_to(obstacles: Obstacles, p: jax.Array) -> jax.Array:
    """Return the distance [] of a point to the surfaces of obstacles at their start."""
    point, zero = p[None], jnp.zeros(1, p.dtype)
    to_one = partial(capsules_obstacle, point, point, zero, kinds=obstacles.kinds)
    return jnp.min(jax.vmap(to_one)(obstacles.p0, obstacles.q0, obstacles.kind, obstacles.size_m))


def _choose_positions(
    tries: jax.Array, margin: jax.Array, radius: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Return a position [n, 3] for each of n obstacles, and whether it is free.

    Args:
        tries: [n, k, 3] positions to try, m, W.
        margin: [n, k] clearance there to cells and fixed obstacles; not free where negative.
        radius: [n] bounding radii.
    """
    n = radius.shape[0]

    def choose_one(p: jax.Array, i: jax.Array) -> tuple[jax.Array, tuple[jax.Array, jax.Array]]:
        apart = jnp.sqrt(jnp.sum((tries[i][:, None] - p) ** 2, axis=2)) - radius - radius[i]
        overlap = jnp.min(jnp.where(jnp.arange(n) < i, apart, 0.0), axis=1)
        score = jnp.where(margin[i] >= 0.0, jnp.minimum(overlap, 0.0), -jnp.inf)
        best = jnp.argmax(score)
        chosen, free = tries[i, best], margin[i, best] >= 0.0
        # A left-out obstacle occupies no position.
        position_m = jnp.where(free, chosen, jnp.inf)
        return write_row(p, position_m, i), (chosen, free)

    _, (positions, free) = jax.lax.scan(choose_one, jnp.zeros((n, 3), tries.dtype), jnp.arange(n))
    return positions, free


def _concatenate_rows(first: Obstacles, second: Obstacles) -> Obstacles:
    """Return the rows of two sets, in order."""
    kinds = tuple(sorted(set(first.kinds) | set(second.kinds)))
    motions = tuple(sorted(set(first.motions) | set(second.motions)))
    first, second = (replace(rows, kinds=kinds, motions=motions) for rows in (first, second))
    joined: Obstacles = jax.tree.map(
        lambda a, b: jnp.concatenate([a, b.astype(a.dtype)]), first, second
    )
    return joined
