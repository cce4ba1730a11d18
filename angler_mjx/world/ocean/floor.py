"""Sea floors of files, and which cells of a world are rock by them or by a field's land."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from angler_kernels.gridded_field import Axis, locate
from angler_mjx.errors import ConfigError
from angler_mjx.files import named
from angler_mjx.world.ocean import cf
from angler_mjx.world.ocean.cf import Wanted
from angler_mjx.world.ocean.field import carried_on, even_axis, stamp

LAND_M = -1e4
"""Depth that stands for land: no cell of any world is above it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Floor:
    """Depths of the sea floor at knots."""

    depth_m: np.ndarray
    """[y, x] of the water: on land that of the nearest water."""
    wet: np.ndarray
    """bool [y, x] where the sea floor is below the surface."""
    knots: tuple[np.ndarray, np.ndarray]
    """Of y and x, rising: degrees or metres."""
    degrees: bool

    @cached_property
    def axes(self) -> tuple[Axis, Axis]:
        """The axes as programs know them."""
        y, x = (even_axis(knots) for knots in self.knots)
        return y, x

    @cached_property
    def digest(self) -> str:
        """Hexadecimal, of everything."""
        made = hashlib.sha256(repr(self.degrees).encode())
        for array in (self.depth_m, self.wet, *self.knots):
            made.update(np.ascontiguousarray(array).tobytes())
        return made.hexdigest()


def load_floor(path: str, variable: str | None) -> Floor:
    """The sea floor of a file, read once for as long as the file stays as it is.

    Args:
        path: of a NetCDF file.
        variable: its name in it, if it is given.

    Raises:
        ConfigError: there is no such file, or it is none that can be used; says why.
        UnsupportedError: what reads it is not installed.
    """
    return _load(path, stamp(path), variable)


@lru_cache(maxsize=8)
def _load(path: str, _: tuple[int, int], variable: str | None) -> Floor:
    below = Wanted(key="variable", name=variable, standard=(*cf.FLOOR, *cf.HEIGHT))
    read = cf.read(Path(path), (below,), cf.METRES)
    depth = read.parts[0]
    if depth.shape[2] > 1 or depth.shape[3] > 1:
        raise ConfigError(
            f"{named(path)}: a sea floor has no depths and no times; take one of them"
        )
    depth = depth[:, :, 0, 0]
    if read.standard[0] in cf.HEIGHT:
        depth = -depth
    wet = np.isfinite(depth) & (depth > 0.0)
    if not wet.any():
        raise ConfigError(
            f"{named(path)}: its sea floor lies nowhere below the surface; depths are positive "
            "downwards, heights have the standard_name height_above_mean_sea_level"
        )
    y, x = read.axes["y"], read.axes["x"]
    if min(len(y.knots), len(x.knots)) < 2:
        raise ConfigError(f"{named(path)}: needs two latitudes and two longitudes at least")
    whole = carried_on(
        depth[:, :, None, None, None], wet[:, :, None], (y.knots, x.knots), y.degrees
    )
    return Floor(depth_m=whole[:, :, 0, 0, 0], wet=wet, knots=(y.knots, x.knots), degrees=y.degrees)


@dataclass(frozen=True, kw_only=True)
class Centres:
    """Middles of the cells of a world along each axis of W, m."""

    x: jax.Array
    y: jax.Array
    z: jax.Array


def dry_cells(
    wet: np.ndarray,
    axes: Sequence[Axis],
    knots: Sequence[np.ndarray],
    place: tuple[jax.Array, jax.Array, jax.Array],
    centres: Centres,
) -> jax.Array:
    """Cells [nx, ny, nz] whose nearest knot is land, or below the sea floor of a field.

    Args:
        wet: bool [y, x, depth].
        axes: y, x and depth.
        knots: of the axes.
        place: knots int32 [3 or more] from which the origin of W is said, what lies beyond them,
            and places on the axes by metre, as `currents.Gridded` has them.
        centres: of the cells.
    """
    y, x, z = (
        _nearest(axis, values, (place[0][i], place[1][i], place[2][i]), along)
        for i, (axis, values, along) in enumerate(
            zip(axes, knots, (centres.y, centres.x, centres.z), strict=True)
        )
    )
    dry = jnp.asarray(~wet)
    return dry[y[None, :, None], x[:, None, None], z[None, None, :]]


def below_floor(
    floor: Floor,
    place: tuple[jax.Array, jax.Array, jax.Array],
    scale: float,
    centres: Centres,
) -> jax.Array:
    """Cells [nx, ny, nz] whose middle lies below the sea floor of its column, or on land.

    The depth of a column is that between the four knots around its middle, linear in both
    directions; it is land where the nearest knot is.

    Args:
        floor: of the file.
        place: as in `dry_cells`, of y and x of the floor's axes.
        scale: metres here to a metre of depth in the file.
        centres: of the cells.
    """
    spots = [
        _spots(axis, values, (place[0][i], place[1][i], place[2][i]), along)
        for i, (axis, values, along) in enumerate(
            zip(floor.axes, floor.knots, (centres.y, centres.x), strict=True)
        )
    ]
    (j, b), (i, a) = spots
    depth = jnp.asarray(floor.depth_m, float)
    low = depth[j][:, i] * (1.0 - a) + depth[j][:, i + 1] * a
    high = depth[j + 1][:, i] * (1.0 - a) + depth[j + 1][:, i + 1] * a
    column = low * (1.0 - b[:, None]) + high * b[:, None]
    near_y, near_x = j + (b > 0.5), i + (a > 0.5)
    wet = jnp.asarray(floor.wet)[near_y][:, near_x]
    column = jnp.where(wet, scale * column, LAND_M)
    return -centres.z[None, None, :] > column.T[:, :, None]


def carried_over(knots: np.ndarray, others: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """For each knot of one axis the knot of another below it, and what lies between, exactly.

    Args:
        knots: [n] of the axis on which places are said.
        others: [m] of the axis on which they are to be said.
    """
    below = np.clip(np.searchsorted(others, knots, side="right") - 1, 0, len(others) - 1)
    return below.astype(np.int32), knots - others[below]


def _spots(
    axis: Axis,
    knots: np.ndarray,
    place: tuple[jax.Array, jax.Array, jax.Array],
    along: jax.Array,
) -> tuple[jax.Array, jax.Array]:
    """Lower knots and shares of the way to the next of places along an axis of W."""
    knot, rest, rate = place
    table = jnp.asarray(knots - knots[0], rest.dtype)

    def one(at: jax.Array) -> tuple[jax.Array, jax.Array]:
        lower, share, _ = locate(axis, table, knot, rest + rate * at)
        return lower, share

    return jax.vmap(one)(along)


def _nearest(
    axis: Axis,
    knots: np.ndarray,
    place: tuple[jax.Array, jax.Array, jax.Array],
    along: jax.Array,
) -> jax.Array:
    lower, share = _spots(axis, knots, place, along)
    return lower + (share > 0.5)
