"""Sea floors of files, and the cells of rock in a world by them or by a field's land."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from angler_kernels.gridded_field import GridAxis, locate_knot
from angler_mjx.errors import ConfigError
from angler_mjx.files import format_path
from angler_mjx.quantities import MAX_COORDINATE_M
from angler_mjx.world.ocean import cf
from angler_mjx.world.ocean.cf import VariableRequest
from angler_mjx.world.ocean.field import even_axis, file_stamp, fill_land_values

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
"""Directions by variable name, where no attribute gives them."""

LAND_M = -1e4
"""Depth value of land: no cell of any world is above it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SeaFloor:
    """Depths of the sea floor at knots."""

    depth_m: np.ndarray
    """[y, x] depth of the water: on land that of the nearest water."""
    wet: np.ndarray
    """bool [y, x] whether the sea floor is below the surface."""
    knots: tuple[np.ndarray, np.ndarray]
    """Knots of y and x, increasing: degrees or metres."""
    degrees: bool

    @cached_property
    def axes(self) -> tuple[GridAxis, GridAxis]:
        """Return the axes in the form that programs use."""
        y, x = (even_axis(knots) for knots in self.knots)
        return y, x

    @cached_property
    def digest(self) -> str:
        """Return the hexadecimal digest of all data."""
        made = hashlib.sha256(repr(self.degrees).encode())
        for array in (self.depth_m, self.wet, *self.knots):
            made.update(np.ascontiguousarray(array).tobytes())
        return made.hexdigest()


def load_floor(path: str, variable: str | None, positive: str | None = None) -> SeaFloor:
    """Read the sea floor of a file, once for each version of the file.

    Args:
        path: path of a NetCDF file.
        variable: its name in the file; None to identify it by its standard_name.
        positive: "up" for heights, "down" for depths; None if the file gives it.

    Raises:
        ConfigError: there is no such file, or it cannot be used; gives the reason.
        UnsupportedError: the library that reads it is not installed.
    """
    return _read_floor(path, file_stamp(path), variable, positive)


@lru_cache(maxsize=8)
def _read_floor(
    path: str, _: tuple[int, int], variable: str | None, positive: str | None
) -> SeaFloor:
    below = VariableRequest(key="variable", name=variable, standard=(*DEPTH, *HEIGHT))
    read = cf.read_variables(Path(path), (below,), cf.METRES)
    depth = read.parts[0]
    if depth.shape[2] > 1 or depth.shape[3] > 1:
        raise ConfigError(
            f"{format_path(path)}: a sea floor has no depths and no times; take one of them"
        )
    depth = depth[:, :, 0, 0]
    if _positive_direction(path, read, depth, positive) == "up":
        depth = -depth
    _require_shallow(path, read, depth)
    wet = np.isfinite(depth) & (depth > 0.0)
    if not wet.any():
        raise ConfigError(
            f"{format_path(path)}: its sea floor ({read.names[0]}) lies nowhere below the surface; "
            "give "
            'another variable or area, or say positive = "up" of heights, "down" of depths'
        )
    y, x = read.axes["y"], read.axes["x"]
    if min(len(y.knots), len(x.knots)) < 2:
        raise ConfigError(f"{format_path(path)}: needs two latitudes and two longitudes at least")
    whole = fill_land_values(
        depth[:, :, None, None, None], wet[:, :, None], (y.knots, x.knots), y.degrees
    )
    return SeaFloor(
        depth_m=whole[:, :, 0, 0, 0], wet=wet, knots=(y.knots, x.knots), degrees=y.degrees
    )


def _positive_direction(
    path: str, read: cf.FileVariables, values: np.ndarray, positive: str | None
) -> str:
    """Return the direction in which a sea floor is positive, "up" or "down".

    Args:
        path: path of the file.
        read: name and attributes of the variable.
        values: values of the variable, m.
        positive: direction in the scenario; None if it has none.

    Raises:
        ConfigError: no direction is given, the file gives both, or the scenario contradicts it.
    """
    name, attributes = read.names[0], read.attributes[0]
    standard = attributes.get("standard_name", "")
    by_name = "down" if standard in DEPTH else "up" if standard in HEIGHT else None
    by_attribute = attributes.get("positive", "").lower()
    directions = {by_name, by_attribute} & {"up", "down"} or {_DIRECTIONS.get(name.lower())} - {
        None
    }
    if positive is not None:
        if directions == {"up", "down"} - {positive}:
            raise ConfigError(
                f"{format_path(path)}: {name} is positive {directions.pop()} by its attributes or "
                "name; leave "
                f'out positive = "{positive}", or correct the file (ncatted)'
            )
        return positive
    if len(directions) == 1:
        return str(directions.pop())
    if not directions and not (np.any(values > 0.0) and np.any(values < 0.0)):
        return "up" if np.any(values < 0.0) else "down"  # in the other direction all of it is land
    why = (
        f"has the standard_name {standard} and positive = {by_attribute}, which contradict each "
        "other"
        if directions
        else "has values of both signs and does not say whether it is a depth or a height"
    )
    raise ConfigError(
        f'{format_path(path)}: {name} {why}; say positive = "down" of depths, "up" of heights'
    )


def _require_shallow(path: str, read: cf.FileVariables, depth: np.ndarray) -> None:
    """Require that depths or heights [y, x], m, are within the bounds of files."""
    far = np.argwhere(np.abs(depth) > MAX_COORDINATE_M)
    if not len(far):
        return
    i, j = far[0]
    y, x = read.axes["y"].knots[i], read.axes["x"].knots[j]
    raise ConfigError(
        f"{format_path(path)}: {read.names[0]} is {abs(depth[i, j]):g} m at y {y:g}, x {x:g}: no "
        "ground "
        f"lies {MAX_COORDINATE_M:g} m deep or high; if the number stands for missing values, name "
        "it as "
        "_FillValue in the file (ncatted), else correct units or scale_factor"
    )


@dataclass(frozen=True, kw_only=True)
class CellCentres:
    """Centres of the cells of a world along each axis of W, m."""

    x: jax.Array
    y: jax.Array
    z: jax.Array


def dry_cells(
    wet: np.ndarray,
    axes: Sequence[GridAxis],
    knots: Sequence[np.ndarray],
    frame: tuple[jax.Array, jax.Array, jax.Array],
    centres: CellCentres,
) -> jax.Array:
    """Return cells [nx, ny, nz] whose nearest knot is land, or below a field's sea floor.

    Args:
        wet: bool [y, x, depth].
        axes: y, x and depth.
        knots: knots of the axes.
        frame: reference knots int32 [3 or more] of the origin of W, its offset from them, and axis
            units per metre, as in `currents.Gridded`.
        centres: centres of the cells.
    """
    y, x, z = (
        _nearest_knots(axis, values, (frame[0][i], frame[1][i], frame[2][i]), along)
        for i, (axis, values, along) in enumerate(
            zip(axes, knots, (centres.y, centres.x, centres.z), strict=True)
        )
    )
    dry = jnp.asarray(~wet)
    return dry[y[None, :, None], x[:, None, None], z[None, None, :]]


def below_floor(
    floor: SeaFloor,
    frame: tuple[jax.Array, jax.Array, jax.Array],
    scale: float,
    centres: CellCentres,
) -> jax.Array:
    """Return cells [nx, ny, nz] whose centre is below the sea floor of its column, or on land.

    The depth of a column is bilinear between the four knots around its centre; it is land where the
    nearest knot is.

    Args:
        floor: sea floor of the file.
        frame: as in `dry_cells`, of y and x of the floor's axes.
        scale: metres here per metre of depth in the file.
        centres: centres of the cells.
    """
    spots = [
        _locate_along(axis, values, (frame[0][i], frame[1][i], frame[2][i]), along)
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


def knots_below(knots: np.ndarray, others: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return for each knot of an axis the knot of another below it, and the exact offset.

    Args:
        knots: [n] knots of the source axis.
        others: [m] knots of the target axis.
    """
    below = np.maximum(np.searchsorted(others, knots, side="right") - 1, 0)
    return below.astype(np.int32), knots - others[below]


def _locate_along(
    axis: GridAxis,
    knots: np.ndarray,
    frame: tuple[jax.Array, jax.Array, jax.Array],
    along: jax.Array,
) -> tuple[jax.Array, jax.Array]:
    """Return lower knots and fractions to the next knot for positions along an axis of W."""
    knot, rest, rate = frame
    table = jnp.asarray(knots - knots[0], rest.dtype)

    def locate_one(at: jax.Array) -> tuple[jax.Array, jax.Array]:
        lower, fraction, _ = locate_knot(axis, table, knot, rest + rate * at)
        return lower, fraction

    return jax.vmap(locate_one)(along)


def _nearest_knots(
    axis: GridAxis,
    knots: np.ndarray,
    frame: tuple[jax.Array, jax.Array, jax.Array],
    along: jax.Array,
) -> jax.Array:
    lower, fraction = _locate_along(axis, knots, frame, along)
    return lower + (fraction > 0.5)
