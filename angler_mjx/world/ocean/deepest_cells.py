"""Positions of worlds in a field: water within spans, and the metres of a degree."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from angler_kernels.table import take_row

_MAJOR_M, _FLATTENING = 6_378_137.0, 1.0 / 298.257223563
"""Ellipsoid WGS 84."""

type Span = tuple[float, float]


def metres_per_degree(latitude_deg: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return metres per degree of latitude and of longitude at a latitude, on the ellipsoid WGS 84.

    pi / 180 times the radius of curvature of the meridian, a (1 - e^2) / (1 - e^2 sin^2)^(3/2), and
    that of the parallel, a cos / (1 - e^2 sin^2)^(1/2) (Torge, Geodesy, 3rd edition, section 4.1).
    """
    e2 = _FLATTENING * (2.0 - _FLATTENING)
    angle = jnp.radians(latitude_deg)
    w = 1.0 - e2 * jnp.sin(angle) ** 2
    north = _MAJOR_M * (1.0 - e2) / (w * jnp.sqrt(w))
    east = _MAJOR_M * jnp.cos(angle) / jnp.sqrt(w)
    return math.pi / 180.0 * north, math.pi / 180.0 * east


@dataclass(frozen=True, kw_only=True)
class DeepestCells:
    """Parts of cells of a field in which worlds may lie, the deepest water first.

    A cell lies between two knots along y and along x. It counts as water down to a depth if all
    four of its knots do.
    """

    knot: np.ndarray
    """int32 [n, 2] lower knots along y and x."""
    low: np.ndarray
    """[n, 2] offset of the part from these knots, in degrees or metres."""
    length: np.ndarray
    """[n, 2] lengths of the part."""
    area: np.ndarray
    """[n] cumulative area of the parts."""
    count: np.ndarray
    """int32 [depth] number of parts, from the first, that are water down to a depth."""

    def sample(self, key: jax.Array, level: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Sample a position, uniform over the area of the parts with water down to a level.

        Args:
            key: random key.
            level: int32 [] index of the depth.

        Returns:
            Lower knot int32 [2] along y and x, and the offset from it [2].
        """
        along, y, x = jax.random.uniform(key, (3,))
        area = jnp.asarray(self.area, float)
        last = take_row(jnp.asarray(self.count), level) - 1
        i = jnp.clip(jnp.searchsorted(area, along * take_row(area, last), side="right"), 0, last)
        low, length = (take_row(jnp.asarray(array, float), i) for array in (self.low, self.length))
        return take_row(jnp.asarray(self.knot), i), low + length * jnp.stack([y, x])


def span_in(key: str, span: Span | None, knots: np.ndarray, *, turns: bool = False) -> Span | None:
    """Return a span in the file's convention: its longitudes may be from 0 to 360.

    Args:
        key: name of the span in a scenario.
        span: min and max; None for all of the file.
        knots: knots of the file's axis.
        turns: whether it is a longitude.

    Raises:
        ValueError: it is not in the file.
    """
    if span is None:
        return None
    turn = 0.0
    if turns:
        fitting = (k for k in (-360.0, 0.0, 360.0) if knots[0] <= span[0] + k <= knots[-1])
        turn = min(fitting, key=abs, default=0.0)
    low, high = span[0] + turn, span[1] + turn
    if not knots[0] <= low <= high <= knots[-1]:
        raise ValueError(
            f"{key} = {list(span)}: needs low <= high within the file's {knots[0]:g} to "
            f"{knots[-1]:g}"
        )
    return low, high


def find_deepest_cells(
    wet: np.ndarray,
    knots: Sequence[np.ndarray],
    degrees: bool,
    y: Span | None,
    x: Span | None,
) -> DeepestCells:
    """Return the parts of cells in which worlds may lie.

    Args:
        wet: bool [y, x, depth] knots with water.
        knots: knots of y and x.
        degrees: whether they are latitudes and longitudes.
        y: min and max latitude, or metres; all if None. A span may be a single position.
        x: min and max longitude, or metres.

    Raises:
        ValueError: there is no water.
    """
    knots = knots[:2]
    limits = []
    for axis, span in zip(knots, (y, x), strict=True):
        low, high = (axis[0], axis[-1]) if span is None else span
        begin, end = np.maximum(axis[:-1], low), np.minimum(axis[1:], high)
        limits.append((begin - axis[:-1], end - begin))
    (low_y, long_y), (low_x, long_x) = limits
    cells = wet[1:, 1:] & wet[:-1, 1:] & wet[1:, :-1] & wet[:-1, :-1]
    deepest = np.cumprod(cells, axis=2).sum(axis=2)
    inside = (long_y[:, None] >= 0) & (long_x[None, :] >= 0) & (deepest > 0)
    iy, ix = np.nonzero(inside)
    if not len(iy):
        spans = {"latitude": y, "longitude": x}
        requested_spans = ", ".join(f"{key} = {list(span)}" for key, span in spans.items() if span)
        raise ValueError(
            f"{requested_spans}: there is no water in the file there; choose another place"
            if requested_spans
            else "there is no water between four of its knots; take a larger part of the model"
        )
    order = np.argsort(-deepest[iy, ix], kind="stable")
    iy, ix = iy[order], ix[order]
    shrink = np.cos(np.radians(knots[0][iy])) if degrees else 1.0
    # A span of a single position has no length and no area: all parts then have equal weight.
    width = [np.where(long_y > 0, long_y, 0.0)[iy], np.where(long_x > 0, long_x, 0.0)[ix]]
    sides = [side if side.any() else np.ones_like(side) for side in width]
    levels = np.arange(wet.shape[2])
    return DeepestCells(
        knot=np.stack([iy, ix], axis=1).astype(np.int32),
        low=np.stack([low_y[iy], low_x[ix]], axis=1),
        length=np.stack(width, axis=1),
        area=np.cumsum(sides[0] * sides[1] * shrink),
        count=np.array([np.sum(deepest[iy, ix] > k) for k in levels], np.int32),
    )


def locate_origin(
    knot: jax.Array,
    beyond: jax.Array,
    knots: Sequence[np.ndarray],
    degrees: bool,
    space: float,
    centre: jax.Array,
) -> tuple[jax.Array, jax.Array]:
    """Return the position of W in a file: that of its origin, and the scale of the axes.

    A tangent plane: the degrees per metre are everywhere those at the position.

    Args:
        knot: int32 [2] knots below the position along y and x.
        beyond: [2] offset of the position from the knots.
        knots: knots of y and x.
        degrees: whether they are latitudes and longitudes.
        space: metres here per metre of the file.
        centre: [2 or 3] point of W at the position, m.

    Returns:
        The offset [2] of the origin from the knot along y and x, and axis units per metre [2].
    """
    north = east = jnp.ones(())
    if degrees:
        north, east = metres_per_degree(take_row(jnp.asarray(knots[0], float), knot[0]) + beyond[0])
    rate = 1.0 / (space * jnp.stack([north, east]))
    return beyond - rate * jnp.stack([centre[1], centre[0]]), rate
