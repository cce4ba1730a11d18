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
from angler_mjx.quantities import FARTHEST_M
from angler_mjx.world.ocean import cf
from angler_mjx.world.ocean.cf import Wanted
from angler_mjx.world.ocean.field import carried_on, even_axis, stamp

DEPTH = (
    "sea_floor_depth_below_sea_level",
    "sea_floor_depth_below_sea_surface",
    "sea_floor_depth_below_mean_sea_level",
    "sea_floor_depth_below_geoid",
    "sea_floor_depth_below_geopotential_datum",
    "sea_floor_depth_below_reference_ellipsoid",
    "sea_floor_depth",
    "depth",
)
HEIGHT = (
    "height_above_mean_sea_level",
    "height_above_reference_ellipsoid",
    "height_above_geopotential_datum",
    "height_above_geoid",
    "bedrock_altitude",
    "surface_altitude",
    "ground_level_altitude",
    "altitude",
    "height",
)
"""Standard names of sea floors that are positive downwards, and upwards as GEBCO's."""
_DIRECTIONS = {
    **dict.fromkeys(("depth", "deptho", "sea_floor_depth"), "down"),
    **dict.fromkeys(("elevation", "altitude", "height"), "up"),
}
"""By names of variables, where no attribute says it."""

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


def load_floor(path: str, variable: str | None, positive: str | None = None) -> Floor:
    """Read the sea floor of a file, once for as long as the file stays as it is.

    Args:
        path: of a NetCDF file.
        variable: its name in the file; None if its standard_name says which it is.
        positive: "up" for heights, "down" for depths; None if the file says it.

    Raises:
        ConfigError: there is no such file, or it is none that can be used; says why.
        UnsupportedError: what reads it is not installed.
    """
    return _load(path, stamp(path), variable, positive)


@lru_cache(maxsize=8)
def _load(path: str, _: tuple[int, int], variable: str | None, positive: str | None) -> Floor:
    below = Wanted(key="variable", name=variable, standard=(*DEPTH, *HEIGHT))
    read = cf.read(Path(path), (below,), cf.METRES)
    depth = read.parts[0]
    if depth.shape[2] > 1 or depth.shape[3] > 1:
        raise ConfigError(
            f"{named(path)}: a sea floor has no depths and no times; take one of them"
        )
    depth = depth[:, :, 0, 0]
    if _direction(path, read, depth, positive) == "up":
        depth = -depth
    _require_shallow(path, read, depth)
    wet = np.isfinite(depth) & (depth > 0.0)
    if not wet.any():
        raise ConfigError(
            f"{named(path)}: its sea floor ({read.names[0]}) lies nowhere below the surface; give "
            'another variable or area, or say positive = "up" of heights, "down" of depths'
        )
    y, x = read.axes["y"], read.axes["x"]
    if min(len(y.knots), len(x.knots)) < 2:
        raise ConfigError(f"{named(path)}: needs two latitudes and two longitudes at least")
    whole = carried_on(
        depth[:, :, None, None, None], wet[:, :, None], (y.knots, x.knots), y.degrees
    )
    return Floor(depth_m=whole[:, :, 0, 0, 0], wet=wet, knots=(y.knots, x.knots), degrees=y.degrees)


def _direction(path: str, read: cf.Read, values: np.ndarray, positive: str | None) -> str:
    """Return the direction in which a sea floor is positive, "up" or "down".

    Args:
        path: of the file.
        read: name and attributes of the variable.
        values: of the variable, m.
        positive: direction that the scenario says; None if it does not.

    Raises:
        ConfigError: nothing says it, the file says both, or the scenario says the other.
    """
    name, attributes = read.names[0], read.attributes[0]
    standard = attributes.get("standard_name", "")
    by_name = "down" if standard in DEPTH else "up" if standard in HEIGHT else None
    by_attribute = attributes.get("positive", "").lower()
    said = {by_name, by_attribute} & {"up", "down"} or {_DIRECTIONS.get(name.lower())} - {None}
    if positive is not None:
        if said == {"up", "down"} - {positive}:
            raise ConfigError(
                f"{named(path)}: {name} is positive {said.pop()} by its attributes or name; leave "
                f'out positive = "{positive}", or correct the file (ncatted)'
            )
        return positive
    if len(said) == 1:
        return str(said.pop())
    if not said and not (np.any(values > 0.0) and np.any(values < 0.0)):
        return "up" if np.any(values < 0.0) else "down"  # the other way round all of it is land
    why = (
        f"has the standard_name {standard} and positive = {by_attribute}, which contradict each "
        "other"
        if said
        else "has values of both signs and does not say whether it is a depth or a height"
    )
    raise ConfigError(
        f'{named(path)}: {name} {why}; say positive = "down" of depths, "up" of heights'
    )


def _require_shallow(path: str, read: cf.Read, depth: np.ndarray) -> None:
    """Require that no depth or height [y, x], m, is beyond those of files."""
    far = np.argwhere(np.abs(depth) > FARTHEST_M)
    if not len(far):
        return
    i, j = far[0]
    y, x = read.axes["y"].knots[i], read.axes["x"].knots[j]
    raise ConfigError(
        f"{named(path)}: {read.names[0]} is {abs(depth[i, j]):g} m at y {y:g}, x {x:g}: no ground "
        f"lies {FARTHEST_M:g} m deep or high; if the number stands for missing values, name it as "
        "_FillValue in the file (ncatted), else correct units or scale_factor"
    )


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
    below = np.maximum(np.searchsorted(others, knots, side="right") - 1, 0)
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
