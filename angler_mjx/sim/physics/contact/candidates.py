"""Candidates for contact: shapes of bodies in W, and where they come near to rock and floor."""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np

from angler_kernels import quaternion
from angler_kernels.clearance import cell_neighbours, point_surface, segment_surface
from angler_mjx.sim.physics.contact.layout import BodyLayout
from angler_mjx.sim.physics.contact.mjx_contact import Shapes, Touches
from angler_mjx.world.obstacles import BOX, CAPSULE, Obstacles
from angler_mjx.world.rock.grid import Grid

FAR_M = 1e4
"""Distance at which shapes that do not exist stand, each that far from the next."""
END_PART = 0.05
"""Part of the axis of a capsule, beside each end, whose nearness to rock is that of the end."""
CUT_END_PART = 1e-3
"""The same of the pieces of a cut axis, where more would let edges of rock pass thin pipes."""
_CORNERS = [[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)]


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Rock:
    """Cells of one world, prepared for look-ups."""

    neighbours: jax.Array
    """int32 [nx + 2, ny + 2, nz + 2] of `cell_neighbours`."""
    origin_m: jax.Array
    """[3] lower corner of cell (0, 0, 0), m, in W."""
    cell_m: jax.Array
    """[] edge of a cell, m."""

    @classmethod
    def of(cls, grid: Grid) -> "Rock":
        """Return the rock of a grid."""
        neighbours = cell_neighbours(grid.occupied)
        return cls(neighbours=neighbours, origin_m=grid.origin_m, cell_m=grid.cell_m)


def locate_shapes(
    layout: BodyLayout,
    hulls: tuple[jax.Array, jax.Array, jax.Array],
    obstacles: Obstacles,
    p: jax.Array,
    q: jax.Array,
) -> Shapes:
    """Return where the shapes of a world are.

    Args:
        layout: of the world.
        hulls: of the robots: ends of the axes of their capsules [R, c, 3], m, in W, and radii
            [R, c].
        obstacles: of the world.
        p: [O, 3] their centres, m, in W.
        q: [O, 4] their attitudes.
    """
    a, b, r = (jnp.reshape(part, (-1, *part.shape[2:])) for part in hulls)
    half = 0.5 * jnp.sqrt(jnp.sum((b - a) ** 2, axis=1))
    position, rotation = [0.5 * (a + b)], [_along(b - a)]
    size = [jnp.stack([r, half, jnp.zeros_like(r)], axis=1)]
    away = FAR_M * (1.0 + jnp.arange(2.0 * layout.obstacles, dtype=p.dtype))
    away = jnp.stack([away, jnp.zeros_like(away), jnp.zeros_like(away)], axis=1)
    turned = jax.vmap(quaternion.to_matrix)(q)
    is_box = obstacles.kind == BOX
    if layout.has_capsules:
        exists = obstacles.exists & ~is_box
        length = jnp.where(obstacles.kind == CAPSULE, obstacles.size_m[:, 1], 0.0)
        round_size = jnp.stack([obstacles.size_m[:, 0], length, jnp.zeros_like(length)], axis=1)
        position.append(jnp.where(exists[:, None], p, away[: layout.obstacles]))
        rotation.append(turned)
        size.append(jnp.where(exists[:, None], round_size, 1e-3))
    if layout.has_boxes:
        exists = obstacles.exists & is_box
        position.append(jnp.where(exists[:, None], p, away[layout.obstacles :]))
        rotation.append(turned)
        size.append(jnp.where(exists[:, None], obstacles.size_m, 1e-3))
    return Shapes(
        position=jnp.concatenate(position),
        rotation=jnp.concatenate(rotation),
        size=jnp.concatenate(size),
    )


def touch_ground(layout: BodyLayout, shapes: Shapes, rock: Rock, floor_z_m: jax.Array) -> Touches:
    """Return the points of shapes that can touch rock and floor.

    Of a capsule these are the spheres at both ends of its axis, and the one of the axis that is
    nearest to rock; of a box its corners. The axis of a long obstacle is cut into pieces: these are
    then the spheres at the ends of all pieces, and the one of each piece that is nearest to rock.

    Args:
        layout: of the world.
        shapes: of the world.
        rock: its rock.
        floor_z_m: [] height of its floor.
    """
    number = jnp.arange(layout.shapes, dtype=jnp.int32)
    boxes = layout.is_box()
    parts = []
    pieces = layout.capsule_pieces()
    is_round = pieces > 0
    round_ones = number[is_round]
    if round_ones.size:
        size = shapes.size[is_round]
        center, reach = shapes.position[is_round], size[:, 1:2] * shapes.rotation[is_round][:, :, 2]
        a, b, r = center - reach, center + reach, size[:, 0]
        parts += [_off_rock(layout, round_ones, a, r, rock)]
        parts += [_off_floor(layout, round_ones, a, r, floor_z_m)]
        is_long = size[:, 1] > 0.0  # the other end of a sphere is the same
        for touch in (
            _off_rock(layout, round_ones, b, r, rock),
            _off_floor(layout, round_ones, b, r, floor_z_m),
        ):
            parts += [_keep(touch, is_long)]
        if layout.axis_pieces:
            parts += _pieces_off_rock(layout, round_ones, a, b, r, rock, pieces[is_round])
        else:
            parts += [_middle_off_rock(layout, round_ones, a, b, r, rock, END_PART)]
    square_ones = number[boxes]
    if square_ones.size:
        corners = jnp.asarray(_CORNERS, shapes.size.dtype) * shapes.size[boxes][:, None]
        turned = jnp.einsum("bij,bcj->bci", shapes.rotation[boxes], corners)
        points = jnp.reshape(shapes.position[boxes][:, None] + turned, (-1, 3))
        owners, none = jnp.repeat(square_ones, 8), jnp.zeros(points.shape[0], points.dtype)
        parts += [_off_rock(layout, owners, points, none, rock)]
        parts += [_off_floor(layout, owners, points, none, floor_z_m)]
    joined: Touches = jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *parts)
    return joined


def _off_rock(
    layout: BodyLayout, shape: jax.Array, point: jax.Array, r: jax.Array, rock: Rock
) -> Touches:
    """Return candidates [k] of spheres of radius r [k] about points [k, 3] against rock."""
    distance, normal = jax.vmap(point_surface, (0, None, None, None))(
        point, rock.neighbours, rock.origin_m, rock.cell_m
    )
    return _sphere_touch(layout.shapes, shape, point, r, distance, normal)


def _middle_off_rock(
    layout: BodyLayout,
    shape: jax.Array,
    a: jax.Array,
    b: jax.Array,
    r: jax.Array,
    rock: Rock,
    end_part: jax.Array | float,
) -> Touches:
    """Return candidates of capsules [k] against rock between the ends of their axes.

    Points in the part ``end_part`` [] or [k] of the axis beside an end are left to its sphere.
    """
    t, distance, normal = jax.vmap(segment_surface, (0, 0, None, None, None))(
        a, b, rock.neighbours, rock.origin_m, rock.cell_m
    )
    inner = (t > end_part) & (t < 1.0 - end_part)
    touch = _sphere_touch(layout.shapes, shape, a + t[:, None] * (b - a), r, distance, normal)
    return _keep(touch, inner)


def _pieces_off_rock(
    layout: BodyLayout,
    shape: jax.Array,
    a: jax.Array,
    b: jax.Array,
    r: jax.Array,
    rock: Rock,
    pieces: np.ndarray,
) -> list[Touches]:
    """Return candidates against rock of capsules [k], whose axes are cut into pieces, int [k].

    They are those of the spheres where two pieces meet, and those between the ends of each piece.
    """
    rows = np.repeat(np.arange(pieces.size), pieces)  # [m], of each piece
    number = np.arange(rows.size) - (np.cumsum(pieces) - pieces)[rows]
    start, end = (jnp.asarray(x / pieces[rows], a.dtype)[:, None] for x in (number, number + 1))
    axis = (b - a)[rows]
    first, last = a[rows] + start * axis, a[rows] + end * axis
    end_part = jnp.asarray(np.where(pieces[rows] > 1, CUT_END_PART, END_PART), a.dtype)
    joints = np.flatnonzero(number > 0)
    return [
        _off_rock(layout, shape[rows[joints]], first[joints], r[rows[joints]], rock),
        _middle_off_rock(layout, shape[rows], first, last, r[rows], rock, end_part),
    ]


def _keep(touch: Touches, where: jax.Array) -> Touches:
    """Return candidates of which those that are not in ``where`` bool [k] touch nothing."""
    return replace(touch, depth_m=jnp.where(where, touch.depth_m, -1.0))


def _off_floor(
    layout: BodyLayout, shape: jax.Array, point: jax.Array, r: jax.Array, floor_z_m: jax.Array
) -> Touches:
    """Return candidates [k] of spheres of radius r [k] about points [k, 3] against the floor."""
    up = jnp.broadcast_to(jnp.array([0.0, 0.0, 1.0], point.dtype), point.shape)
    distance = point[:, 2] - floor_z_m
    return _sphere_touch(layout.shapes + 1, shape, point, r, distance, up)


def _sphere_touch(
    ground: int,
    shape: jax.Array,
    center: jax.Array,
    r: jax.Array,
    distance: jax.Array,
    normal: jax.Array,
) -> Touches:
    depth = r - distance
    return Touches(
        depth_m=depth,
        position=center - normal * (r - 0.5 * depth)[:, None],
        normal=normal,
        first=jnp.full(shape.shape, ground, jnp.int32),
        second=shape,
    )


def join_touches(found: Touches | None, ground: Touches) -> Touches:
    """Return candidates among bodies and against the ground as one."""
    if found is None:
        return ground
    joined: Touches = jax.tree.map(lambda x, y: jnp.concatenate([x, y]), found, ground)
    return joined


def _along(axis: jax.Array) -> jax.Array:
    """Return rotations [k, 3, 3] whose third column is along vectors [k, 3]; up for zero."""
    square = jnp.sum(axis * axis, axis=1, keepdims=True)
    up = jnp.array([0.0, 0.0, 1.0], axis.dtype)
    unit = jnp.where(square > 0.0, axis / jnp.sqrt(jnp.where(square > 0.0, square, 1.0)), up)
    side = jnp.where(jnp.abs(unit[:, :1]) < 0.5, jnp.eye(3, dtype=axis.dtype)[0], up)
    first = jnp.cross(side, unit)
    first = first / jnp.sqrt(jnp.sum(first * first, axis=1, keepdims=True))
    return jnp.stack([first, jnp.cross(unit, first), unit], axis=2)
