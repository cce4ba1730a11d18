"""NetCDF files by the CF conventions: variables by their standard names, axes in units of ours.

Only this module knows xarray. See cfconventions.org, version 1.11, chapters 3 (units and standard
names), 4 (axes) and 5 (coordinates).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from angler_mjx.errors import ConfigError, UnsupportedError, shown, size
from angler_mjx.files import named

EXTRA = "pip install 'angler-mjx[ocean]'"

MOST_BYTES = 2**28
"""Of one field in memory, as float32: programs hold a copy each."""

AXES = ("y", "x", "depth", "time")
"""Names of the axes here, in the order of every array."""

_STANDARD = {
    "latitude": "y",
    "longitude": "x",
    "projection_y_coordinate": "y",
    "projection_x_coordinate": "x",
    "depth": "depth",
    "height": "depth",
    "altitude": "depth",
    "time": "time",
}
_LETTERS = {"X": "x", "Y": "y", "Z": "depth", "T": "time"}
_NAMES = {
    **{name: "y" for name in ("lat", "latitude", "y")},
    **{name: "x" for name in ("lon", "longitude", "x")},
    **{name: "depth" for name in ("depth", "lev", "z")},
    "time": "time",
}
_DEGREES = {
    **dict.fromkeys(("degrees_north", "degree_north", "degrees_n", "degree_n"), "y"),
    **dict.fromkeys(("degrees_east", "degree_east", "degrees_e", "degree_e"), "x"),
}
METRES = {"m": 1.0, "meter": 1.0, "meters": 1.0, "metre": 1.0, "metres": 1.0, "km": 1e3}
PER_SECOND = {
    **dict.fromkeys(("m s-1", "m/s", "m s^-1", "m s**-1", "m.s-1", "ms-1", "meter/second"), 1.0),
    **dict.fromkeys(("meters/second", "metre/second", "meter second-1", "meters s-1"), 1.0),
    **dict.fromkeys(("cm s-1", "cm/s", "cm s^-1", "cm.s-1", "centimeter/second"), 0.01),
    **dict.fromkeys(("mm s-1", "mm/s"), 0.001),
    **dict.fromkeys(("km h-1", "km/h"), 1.0 / 3.6),
    **dict.fromkeys(("knot", "knots", "kt", "kts"), 1852.0 / 3600.0),
}

EASTWARD = ("eastward_sea_water_velocity", "sea_water_x_velocity")
NORTHWARD = ("northward_sea_water_velocity", "sea_water_y_velocity")
UPWARD = ("upward_sea_water_velocity",)
FLOOR = (
    "sea_floor_depth_below_sea_level",
    "sea_floor_depth_below_sea_surface",
    "sea_floor_depth_below_mean_sea_level",
    "sea_floor_depth_below_geoid",
    "sea_floor_depth",
)
HEIGHT = (
    "height_above_mean_sea_level",
    "height_above_reference_ellipsoid",
    "height_above_geoid",
    "surface_altitude",
    "altitude",
)
"""Heights of the ground: GEBCO's files have the sea floor negative in them."""


@dataclass(frozen=True, kw_only=True)
class Axis:
    """Knots of one axis, rising."""

    knots: np.ndarray
    """[n] float64: degrees or metres of y and x; metres below the surface; seconds after the
    first."""
    degrees: bool = False
    begin: np.datetime64 | None = None
    """Of the time axis: what its first knot is."""
    turned: bool = False
    """Whether the file has its knots the other way round."""


@dataclass(frozen=True, kw_only=True)
class Wanted:
    """A variable that is looked for."""

    key: str
    """What a scenario calls it."""
    name: str | None
    """In the file, where that is given; else it is found by its standard name."""
    standard: tuple[str, ...]
    needed: bool = True
    """Whether the file must have it."""


@dataclass(frozen=True, kw_only=True)
class Read:
    """Variables of a file on their common axes."""

    parts: tuple[np.ndarray, ...]
    """[y, x, depth, time] each; m/s, or m; NaN where nothing is known."""
    axes: Mapping[str, Axis]
    standard: tuple[str, ...]
    """Their standard names; empty where there is none."""


def read(path: Path, wanted: Sequence[Wanted], units: Mapping[str, float]) -> Read:
    """Variables of a file.

    Args:
        path: of a NetCDF file.
        wanted: variables; those that the file need not have and has not are left out.
        units: that they may have, and how much of ours each is.

    Raises:
        ConfigError: there is no such file, or it cannot be used; says why.
        UnsupportedError: what reads it is not installed.
    """
    with _opened(path) as data:
        chosen = [_chosen(path, data, one) for one in wanted]
        arrays = [data[name] for name in chosen if name is not None]
        axes = _axes(path, data, arrays[0])
        for one in arrays[1:]:
            if set(one.dims) != set(arrays[0].dims):
                raise ConfigError(
                    f"{named(path)}: {arrays[0].name} and {one.name} stand on different axes, "
                    f"{_said(arrays[0])} and {_said(one)}; interpolate them to one grid first"
                )
        count = 4 * len(arrays) * int(np.prod(arrays[0].shape))
        if count > MOST_BYTES:
            raise ConfigError(
                f"{named(path)}: its field takes {size(count)}; {size(MOST_BYTES)} are the most "
                "that programs hold: take fewer depths or times, or a smaller area"
            )
        try:
            parts = tuple(_laid(array, axes) * _unit(path, array, units) for array in arrays)
        except (OSError, RuntimeError) as error:
            raise ConfigError(f"{named(path)}: is damaged ({error}); fetch it again") from error
    none = {kind: Axis(knots=np.zeros(1)) for kind in ("depth", "time")}
    return Read(
        parts=parts,
        axes={**none, **{kind: one for kind, (_, one) in axes.items()}},
        standard=tuple(str(array.attrs.get("standard_name", "")) for array in arrays),
    )


def _opened(path: Path) -> Any:
    """The file as a dataset, nothing read yet."""
    try:
        with path.open("rb") as file:
            head = file.read(8)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ConfigError(f"{named(path)}: cannot be read ({reason})") from error
    if head.startswith(b"\x89HDF\r\n\x1a\n"):
        engine = "h5netcdf"
    elif head[:4] in (b"CDF\x01", b"CDF\x02"):
        engine = "scipy"
    else:
        raise ConfigError(
            f"{named(path)}: is no NetCDF file (nor NetCDF-4); "
            "of CDF-5 and other formats make one with nccopy -k nc4"
        )
    try:
        import h5netcdf  # noqa: F401
        import h5py  # noqa: F401
        import xarray
    except ImportError as error:
        raise UnsupportedError(
            f"{named(path)}: files of ocean models need xarray, h5netcdf and h5py: {EXTRA}"
        ) from error
    try:
        data = xarray.open_dataset(path, engine=engine, decode_times=False)
    except (ValueError, OSError, KeyError, RuntimeError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise ConfigError(f"{named(path)}: cannot be read as NetCDF ({reason})") from error
    try:
        return xarray.decode_cf(data, mask_and_scale=False, decode_timedelta=False)
    except (ValueError, OverflowError) as error:
        data.close()
        reason = str(error).splitlines()[0].partition(". Try")[0]
        raise ConfigError(
            f"{named(path)}: its times cannot be read ({reason}): they must be in the standard "
            'calendar, with units as in "hours since 2024-01-01"'
        ) from error


def _chosen(path: Path, data: Any, one: Wanted) -> str | None:
    """The name of the variable that is meant."""
    key, name = one.key, one.name
    about = {str(v): data[v].attrs.get("standard_name", "") for v in data.data_vars}
    if name is not None:
        if name not in about:
            raise ConfigError(
                f"{named(path)}: {key} = {shown(name)}: no variable of this file; there is "
                f"{', '.join(about) or 'none'}"
            )
        return name
    for wanted in one.standard:
        found = [variable for variable, has in about.items() if has == wanted]
        if len(found) > 1:
            raise ConfigError(
                f"{named(path)}: {', '.join(found)} all have the standard_name {wanted}; say which "
                f'one is meant: {key} = "{found[0]}"'
            )
        if found:
            return found[0]
    if not one.needed:
        return None
    raise ConfigError(
        f"{named(path)}: no variable has the standard_name {one.standard[0]}; say which is meant "
        f"by {key} = NAME; there is {', '.join(about) or 'none'}"
    )


def _axes(path: Path, data: Any, array: Any) -> dict[str, tuple[str, Axis]]:
    """Dimension and knots of each axis of a variable, by our name of the axis."""
    found: dict[str, tuple[str, Axis]] = {}
    for dim in map(str, array.dims):
        if dim not in data.variables:
            flat = [str(one) for one in array.coords if array.coords[one].ndim == 2]
            why = "its places are given by two-dimensional coordinates" if flat else "no coordinate"
            raise ConfigError(
                f"{named(path)}: dimension {dim} of {array.name} has {why}: give a file with "
                "one-dimensional latitude, longitude, depth and time (cdo remapbil makes one)"
            )
        kind = _kind(dim, data[dim])
        if kind is None:
            if data.sizes[dim] == 1:
                continue
            raise ConfigError(
                f"{named(path)}: dimension {dim} of {array.name} is none of latitude, longitude, "
                "depth and time; take one slice of it (ncks -d), or give it its standard_name"
            )
        if kind in found:
            raise ConfigError(
                f"{named(path)}: {found[kind][0]} and {dim} of {array.name} are both {kind}; "
                "give them their standard_name"
            )
        found[kind] = (dim, _knots(path, kind, dim, data[dim]))
    for kind, name in (("y", "latitude"), ("x", "longitude")):
        if kind not in found:
            raise ConfigError(f"{named(path)}: {array.name} has no {name}, only {_said(array)}")
    if found["y"][1].degrees != found["x"][1].degrees:
        raise ConfigError(
            f"{named(path)}: {found['y'][0]} and {found['x'][0]} have different units; give both "
            "in degrees, or both in m"
        )
    return found


def _kind(dim: str, coordinate: Any) -> str | None:
    about = coordinate.attrs
    if np.issubdtype(coordinate.dtype, np.datetime64):
        return "time"
    units = str(about.get("units", "")).lower()
    ways = (
        _STANDARD.get(str(about.get("standard_name", ""))),
        _DEGREES.get(units),
        _LETTERS.get(str(about.get("axis", "")).upper()),
        _NAMES.get(dim.lower()),
    )
    return next((way for way in ways if way is not None), None)


def _knots(path: Path, kind: str, dim: str, coordinate: Any) -> Axis:
    """Knots of one axis in our units, rising where they may be turned round."""
    if kind == "time":
        return _times(path, dim, coordinate)
    values = np.asarray(coordinate.values, np.float64)
    units = str(coordinate.attrs.get("units", "")).strip().lower()
    degrees = kind != "depth" and (units in _DEGREES or units in ("degrees", "degree"))
    if not degrees:
        if units not in METRES:
            raise ConfigError(
                f"{named(path)}: {dim} has the units {shown(units)}: must be m or km"
                + ("" if kind == "depth" else ", degrees_north or degrees_east")
            )
        values = values * METRES[units]
    if kind == "depth" and _upward(coordinate, values):
        values = -values
    if degrees and kind == "x":
        values = np.unwrap(values, period=360.0)
    _require_rising(path, dim, values, either=True)
    return Axis(knots=np.sort(values), degrees=degrees, turned=values[0] > values[-1])


def _upward(coordinate: Any, values: np.ndarray) -> bool:
    """Whether a vertical axis counts upwards: as it says, else by its sign."""
    positive = str(coordinate.attrs.get("positive", "")).lower()
    if positive in ("up", "down"):
        return positive == "up"
    if coordinate.attrs.get("standard_name") in ("height", "altitude"):
        return True
    return bool(np.all(values <= 0.0) and np.any(values < 0.0))


def _times(path: Path, dim: str, coordinate: Any) -> Axis:
    values = coordinate.values
    if not np.issubdtype(values.dtype, np.datetime64):
        raise ConfigError(
            f"{named(path)}: {dim} has the units {shown(str(coordinate.attrs.get('units', '')))}: "
            'times must say theirs as in "hours since 2024-01-01", in the standard calendar'
        )
    if np.any(np.isnat(values)):
        raise ConfigError(f"{named(path)}: {dim} has missing times; cut them off")
    seconds = (values - values[0]) / np.timedelta64(1, "s")
    _require_rising(path, dim, seconds, either=False)
    return Axis(knots=seconds, begin=values[0])


def _require_rising(path: Path, dim: str, knots: np.ndarray, *, either: bool) -> None:
    step = np.diff(knots)
    rises = np.all(step > 0) or (either and np.all(step < 0))
    if not (np.all(np.isfinite(knots)) and rises):
        wrong = np.flatnonzero(~(step > 0))
        where = f" (at number {int(wrong[0]) + 1}, from 0)" if len(wrong) else ""
        raise ConfigError(
            f"{named(path)}: {dim} must {'rise or fall' if either else 'rise'} from each value to "
            f"the next{where}; sort the file along it"
        )


def _laid(array: Any, axes: Mapping[str, tuple[str, Axis]]) -> np.ndarray:
    """Values [y, x, depth, time] of a variable, axes rising."""
    kinds = [kind for kind in AXES if kind in axes]
    order = [axes[kind][0] for kind in kinds]
    alone = {dim: 0 for dim in array.dims if dim not in order}
    values: np.ndarray = np.asarray(array.isel(alone).transpose(*order).values, np.float64)
    turned = [slice(None, None, -1 if axes[kind][1].turned else 1) for kind in kinds]
    whole = [slice(None) if kind in axes else None for kind in AXES]
    laid: np.ndarray = values[tuple(turned)][tuple(whole)]
    return laid


def _unit(path: Path, array: Any, known: Mapping[str, float]) -> float:
    units = " ".join(str(array.attrs.get("units", "")).lower().split())
    if units not in known:
        some = "m s-1, cm s-1, km h-1 or knots" if known is PER_SECOND else "m or km"
        raise ConfigError(
            f"{named(path)}: {array.name} has the units {shown(units)}: must be {some}; say them "
            "in the file (ncatted -a units)"
        )
    return known[units]


def _said(array: Any) -> str:
    return ", ".join(f"{dim} ({n})" for dim, n in zip(array.dims, array.shape, strict=True))
