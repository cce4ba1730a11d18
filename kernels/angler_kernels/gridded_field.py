"""Velocity fields on a grid: linear in space and time between knots, with their derivatives.

Axes are y, x, depth and time, in that order. A position on an axis is a knot and the remainder
beyond it, so that single precision suffices far from the first knot.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from angler_kernels.table import count_not_above, take_row


@dataclass(frozen=True, kw_only=True)
class GridAxis:
    """Axis of a grid."""

    count: int
    """Number of knots."""
    step: float | None
    """Distance from one knot to the next where it is constant, else None. Any number for a single
    knot."""
    knots: tuple[float, ...] = ()
    """Positions of the knots where steps differ and knots are few; programs hold them as
    numbers."""


MAX_STATIC_KNOTS = 16
"""Maximum number of knots that programs hold as numbers."""

type AxisPosition = tuple[jax.Array, jax.Array, jax.Array]
"""Lower knot int32 [], fraction of the way to the next [], and derivative of that fraction [] by
the position on the axis: 0 beyond the ends, where the field is held."""


def locate_knot(
    axis: GridAxis, knots: jax.Array | None, knot: jax.Array, rest: jax.Array
) -> AxisPosition:
    """Return the position on an axis: the knots that enclose it and the fraction between them.

    Args:
        axis: static.
        knots: [count] positions of the knots, rising, where their steps differ and they are many.
        knot: int32 [] knot from which the position is measured.
        rest: [] distance beyond that knot, of either sign.
    """
    if axis.count == 1:
        zero = jnp.zeros_like(rest)
        return jnp.zeros_like(knot), zero, zero
    last = axis.count - 1
    if axis.step is not None:
        inverse = 1.0 / axis.step
        low, high = (-knot).astype(rest.dtype), (last - knot).astype(rest.dtype)
        steps = rest * inverse
        clamped = jnp.clip(steps, low, high)
        lower = jnp.minimum(jnp.floor(clamped), high - 1.0)
        is_inside = (steps >= low) & (steps <= high)
        return knot + lower.astype(jnp.int32), clamped - lower, jnp.where(is_inside, inverse, 0.0)
    if axis.knots:
        positions = np.asarray(axis.knots, rest.dtype)
        lengths = np.diff(positions)
        begin = take_row(positions, knot)
        lower = jnp.sum(positions[1:last] <= begin + rest, dtype=jnp.int32)
        before, length = take_row(positions, lower), take_row(lengths, lower)
    elif knots is not None:
        begin = take_row(knots, knot)
        lower = jnp.clip(count_not_above(knots, begin + rest) - 1, 0, last - 1)
        before = take_row(knots, lower)
        length = take_row(knots, lower + 1) - before
    else:
        raise TypeError("an axis of steps that differ needs its knots")
    fraction = (rest - (before - begin)) / length
    clamped = jnp.clip(fraction, 0.0, 1.0)
    return lower, clamped, jnp.where(fraction == clamped, 1.0 / length, 0.0)


def interpolate_linear(
    values: jax.Array, shape: tuple[int, int, int, int, int], spots: Sequence[AxisPosition]
) -> list[jax.Array]:
    """Interpolate a field between its knots, with its derivatives by the positions on the axes.

    Args:
        values: flat, of ``shape`` [y, x, depth, time, component] in row-major order.
        shape: static.
        spots: on each axis, from `locate_knot`.

    Returns:
        The value [component], then its derivatives [component] by time, depth, x and y.
    """
    count = shape[4]
    steps = [min(n, 2) for n in shape[:4]]

    def read_row(lower: list[jax.Array]) -> list[list[jax.Array]]:
        """Return values at one or two times."""
        index = lower[0]
        for k, n in zip(lower[1:], shape[1:4], strict=True):
            index = index * n + k
        part = jax.lax.dynamic_slice(
            values, (index * count,), (steps[3] * count,), allow_negative_indices=False
        )
        return [[part[k * count : (k + 1) * count]] for k in range(steps[3])]

    def interpolate_axis(axis: int, lower: list[jax.Array]) -> list[jax.Array]:
        """Return the field where the knots of the axes before ``axis`` are chosen."""
        k, fraction, slope = spots[axis]
        if axis == 3:
            ends = read_row([*lower, k])
        else:
            ends = [interpolate_axis(axis + 1, [*lower, k + i]) for i in range(steps[axis])]
        if len(ends) == 1:
            return [*ends[0], jnp.zeros_like(ends[0][0])]
        low, high = ends
        interpolated = [x + fraction * (y - x) for x, y in zip(low, high, strict=True)]
        return [*interpolated, slope * (high[0] - low[0])]

    return interpolate_axis(0, [])


def gridded_velocity(
    p: jax.Array,
    t: jax.Array,
    values: jax.Array,
    shape: tuple[int, int, int, int, int],
    axes: Sequence[tuple[GridAxis, jax.Array | None]],
    knot: jax.Array,
    rest: jax.Array,
    rate: jax.Array,
    factor: jax.Array,
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return velocity, its rate and its Jacobian of a field on a grid (see `current_field`).

    Args:
        p: [3] m.
        t: [] s.
        values: as in `interpolate_linear`; components are those along x, y and, if there are three,
            z.
        shape: static.
        axes: y, x, depth and time, each with its knots where their steps differ.
        knot: int32 [4] knot of each axis from which p = 0 and t = 0 are measured.
        rest: [4] distance of p = 0 and t = 0 beyond those knots.
        rate: [4] positions on the axes by metre along y, x and z, and by second.
        factor: [3] of the velocity along x, y and z.
    """
    coordinates = (p[1], p[0], p[2], t)
    spots = [
        locate_knot(axis, knots, knot[i], rest[i] + rate[i] * coordinates[i])
        for i, (axis, knots) in enumerate(axes)
    ]
    level, *slopes = interpolate_linear(values, shape, spots)
    by_t, by_z, by_x, by_y = (
        slope * rate[i] for slope, i in zip(slopes, (3, 2, 1, 0), strict=True)
    )
    zero = jnp.zeros_like(t)

    def build_vector(part: jax.Array) -> jax.Array:
        up = factor[2] * part[2] if shape[4] == 3 else zero
        return jnp.stack([factor[0] * part[0], factor[1] * part[1], up])

    v, v_t, *columns = (build_vector(part) for part in (level, by_t, by_x, by_y, by_z))
    return v, v_t, jnp.stack(columns, axis=1)
