"""NetCDF files by the CF conventions: variables by standard names, axes in our units.

Only this module uses xarray. See cfconventions.org, version 1.11, chapters 2.5 (missing values), 3
(units and standard names), 4 (axes) and 5 (coordinates, grid mappings).
"""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from angler_mjx.errors import ConfigError, UnsupportedError, format_bytes, format_value
from angler_mjx.files import format_path
from angler_mjx.world.ocean.missing import find_missing

if TYPE_CHECKING:
    import xarray

EXTRA = "pip install 'angler-mjx[ocean]'"

MAX_BYTES = 2**28
"""Max size of one field in memory, as float32: programs hold a copy each."""

_REASON = 400
"""Max number of characters of another library's message."""

AXES = ("y", "x", "depth", "time")
"""Names of the axes here, in the order of every array."""

_STANDARD = {
    "latitude": "y",
    "longitude": "x",
    "projection_y_coordinate": "y",
    "projection_x_coordinate": "x",
    **dict.fromkeys(("depth", "depth_below_geoid", "height", "altitude"), "depth"),
    "height_above_mean_sea_level": "depth",
    "height_above_geopotential_datum": "depth",
    "height_above_reference_ellipsoid": "depth",
    "time": "time",
}
_HEIGHTS = ("height", "altitude")
"""Prefixes of the standard names of vertical axes that count upwards."""
_FOREIGN = (
    "grid_latitude",
    "grid_longitude",
    "projection_y_angular_coordinate",
    "projection_x_angular_coordinate",
)
"""Standard names of axes in degrees other than latitude and longitude."""
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
_REGRID = (
    "first turn its components to east and north (of a rotated pole: cdo rotuvb), then interpolate "
    "them to one-dimensional latitude and longitude (cdo remapbil); docs/how_to/ocean.md says how"
)
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
NORTH_OR_Y, EAST_OR_X = ("northward", "y_velocity"), ("eastward", "x_velocity")
"""Words in the standard names of components along each axis."""


@dataclass(frozen=True, kw_only=True)
class CoordinateAxis:
    """Knots of one axis, increasing."""

    knots: np.ndarray
    """[n] float64: degrees or metres of y and x; metres below the surface; seconds after the
    first."""
    degrees: bool = False
    begin: np.datetime64 | None = None
    """Time of the first knot of a time axis."""
    turned: bool = False
    """Whether the file's knots are in reverse order."""


@dataclass(frozen=True, kw_only=True)
class VariableRequest:
    """A requested variable."""

    key: str
    """Its name in a scenario."""
    name: str | None
    """Its name in the file; if None, it is identified by its standard name."""
    standard: tuple[str, ...]
    name_parts: tuple[str, ...] = ()
    """Words of which its standard name, if any, must contain at least one; any name if empty."""
    needed: bool = True
    """Whether the file must have it."""


@dataclass(frozen=True, kw_only=True)
class FileVariables:
    """Variables of a file on their common axes."""

    parts: tuple[np.ndarray, ...]
    """[y, x, depth, time] each; m/s, or m; NaN where missing."""
    axes: Mapping[str, CoordinateAxis]
    names: tuple[str, ...]
    """Names of the variables in the file."""
    attributes: tuple[Mapping[str, str], ...]
    """Attributes of the variables, as text."""


def read_variables(
    path: Path, wanted: Sequence[VariableRequest], units: Mapping[str, float]
) -> FileVariables:
    """Read variables of a file.

    Args:
        path: path of a NetCDF file.
        wanted: requested variables; optional ones that the file lacks are left out.
        units: accepted units, and the factor of each to our unit.

    Raises:
        ConfigError: there is no such file, or it cannot be used; gives the reason.
        UnsupportedError: the library that reads it is not installed.
    """
    with _open_file(path) as stored:
        data = _decode_dataset(path, stored)
        chosen = [_choose_variable(path, data, variable) for variable in wanted]
        arrays = [data[name] for name in chosen if name is not None]
        axes = _read_axes(path, stored, data, arrays[0])
        for array in arrays[1:]:
            if set(array.dims) != set(arrays[0].dims):
                raise ConfigError(
                    f"{format_path(path)}: {arrays[0].name} and {array.name} stand on different "
                    "axes, "
                    f"{_format_axes(arrays[0])} and {_format_axes(array)}; interpolate them to one "
                    "grid first"
                )
        for array in arrays:
            _require_frame(path, data, array, axes)
        count = 4 * len(arrays) * int(np.prod(arrays[0].shape))
        if count > MAX_BYTES:
            raise ConfigError(
                f"{format_path(path)}: its field takes {format_bytes(count)}; "
                f"{format_bytes(MAX_BYTES)} are the most "
                "that programs hold: take fewer depths or times, or a smaller area"
            )
        try:
            parts = tuple(
                _order_axes(_mask_missing(path, stored[array.name], array), axes)
                * _unit_factor(path, array, units)
                for array in arrays
            )
        except (OSError, RuntimeError) as error:
            raise ConfigError(
                f"{format_path(path)}: is damaged ({error}); fetch it again"
            ) from error
    none = {kind: CoordinateAxis(knots=np.zeros(1)) for kind in ("depth", "time")}
    return FileVariables(
        parts=parts,
        axes={**none, **{kind: axis for kind, (_, axis) in axes.items()}},
        names=tuple(str(array.name) for array in arrays),
        attributes=tuple({k: str(v) for k, v in array.attrs.items()} for array in arrays),
    )


def _open_file(path: Path) -> "xarray.Dataset":
    """Open the file as a dataset of stored values: packed, with fill values, times as numbers."""
    try:
        with path.open("rb") as file:
            head = file.read(8)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ConfigError(f"{format_path(path)}: cannot be read ({reason})") from error
    if head.startswith(b"\x89HDF\r\n\x1a\n"):
        engine = "h5netcdf"
    elif head[:4] in (b"CDF\x01", b"CDF\x02"):
        engine = "scipy"
    else:
        raise ConfigError(
            f"{format_path(path)}: is no NetCDF file (nor NetCDF-4); "
            "of CDF-5 and other formats make one with nccopy -k nc4"
        )
    try:
        import cftime  # noqa: F401
        import h5netcdf  # noqa: F401
        import h5py  # noqa: F401
        import xarray
    except ImportError as error:
        raise UnsupportedError(
            f"{format_path(path)}: files of ocean models need xarray, h5netcdf, h5py and cftime: "
            f"{EXTRA}"
        ) from error
    try:
        return xarray.open_dataset(path, engine=engine, mask_and_scale=False, decode_times=False)
    except (ValueError, OSError, KeyError, RuntimeError) as error:
        raise ConfigError(
            f"{format_path(path)}: cannot be read as NetCDF ({_format_reason(error)})"
        ) from error


def _decode_dataset(path: Path, stored: "xarray.Dataset") -> "xarray.Dataset":
    """Return a dataset with unpacked values, NaN for fill values; times stay numbers."""
    import xarray

    try:
        with warnings.catch_warnings():  # several fill values: all of them are missing
            warnings.simplefilter("ignore", xarray.SerializationWarning)
            return xarray.decode_cf(stored, decode_times=False)
    except (ValueError, TypeError, KeyError) as error:
        raise ConfigError(
            f"{format_path(path)}: cannot be read as NetCDF ({_format_reason(error)})"
        ) from error


def _mask_missing(
    path: Path, stored: "xarray.DataArray", array: "xarray.DataArray"
) -> "xarray.DataArray":
    """Return a variable with NaN for values that are missing by its attributes.

    Args:
        path: path of the file.
        stored: the variable as stored in the file.
        array: the same unpacked.
    """
    try:
        missing = find_missing(np.asarray(stored.values), stored.attrs)
    except ValueError as error:
        raise ConfigError(f"{format_path(path)}: {array.name}: {error}") from error
    return array.astype(np.float64).where(~missing) if missing.any() else array


def _format_reason(error: BaseException) -> str:
    """Return the message of another library on one line."""
    return " ".join(str(error).split())[:_REASON] or type(error).__name__


def _choose_variable(path: Path, data: "xarray.Dataset", request: VariableRequest) -> str | None:
    """Return the name of the requested variable."""
    key, name = request.key, request.name
    about = {str(v): data[v].attrs.get("standard_name", "") for v in data.data_vars}
    if name is not None:
        if name not in about:
            raise ConfigError(
                f"{format_path(path)}: {key} = {format_value(name)}: no variable of this file; "
                "there is "
                f"{', '.join(about) or 'none'}"
            )
        standard = str(about[name])
        if (
            standard
            and request.name_parts
            and not any(word in standard for word in request.name_parts)
        ):
            raise ConfigError(
                f"{format_path(path)}: {key} = {format_value(name)}: has the standard_name "
                f"{standard}, must be "
                f"as in {' or '.join(request.standard)}; name another variable"
            )
        return name
    for wanted in request.standard:
        matches = [variable for variable, has in about.items() if has == wanted]
        if len(matches) > 1:
            raise ConfigError(
                f"{format_path(path)}: {', '.join(matches)} all have the standard_name {wanted}; "
                "say which "
                f'one is meant: {key} = "{matches[0]}"'
            )
        if matches:
            return matches[0]
    if not request.needed:
        return None
    raise ConfigError(
        f"{format_path(path)}: no variable has the standard_name {request.standard[0]}; say which "
        "is meant "
        f"by {key} = NAME; there is {', '.join(about) or 'none'}"
    )


def _read_axes(
    path: Path, stored: "xarray.Dataset", data: "xarray.Dataset", array: "xarray.DataArray"
) -> dict[str, tuple[str, CoordinateAxis]]:
    """Return dimension and knots of each axis of a variable, by our name of the axis."""
    axes_by_kind: dict[str, tuple[str, CoordinateAxis]] = {}
    for dim in map(str, array.dims):
        if dim not in data.variables:
            flat = [str(name) for name in array.coords if array.coords[name].ndim == 2]
            if flat:
                raise ConfigError(
                    f"{format_path(path)}: dimension {dim} of {array.name} has no coordinate of "
                    "its own, "
                    f"only two-dimensional ones ({', '.join(flat)}): {_REGRID}"
                )
            raise ConfigError(
                f"{format_path(path)}: dimension {dim} of {array.name} has no coordinate: give a "
                "file "
                "with one-dimensional latitude, longitude, depth and time"
            )
        kind = _axis_kind(path, dim, data[dim])
        if kind is None:
            if data.sizes[dim] == 1:
                continue
            raise ConfigError(
                f"{format_path(path)}: dimension {dim} of {array.name} is none of latitude, "
                "longitude, "
                "depth and time; take one slice of it (ncks -d), or give it its standard_name"
            )
        if kind in axes_by_kind:
            raise ConfigError(
                f"{format_path(path)}: {axes_by_kind[kind][0]} and {dim} of {array.name} are both "
                f"{kind}; "
                "give them their standard_name"
            )
        axes_by_kind[kind] = (
            dim,
            _read_knots(path, kind, dim, _mask_missing(path, stored[dim], data[dim])),
        )
    for kind, name in (("y", "latitude"), ("x", "longitude")):
        if kind not in axes_by_kind:
            raise ConfigError(
                f"{format_path(path)}: {array.name} has no {name}, only {_format_axes(array)}"
            )
    if axes_by_kind["y"][1].degrees != axes_by_kind["x"][1].degrees:
        raise ConfigError(
            f"{format_path(path)}: {axes_by_kind['y'][0]} and {axes_by_kind['x'][0]} have "
            "different units; give both "
            "in degrees, or both in m"
        )
    return axes_by_kind


def _axis_kind(path: Path, dim: str, coordinate: "xarray.DataArray") -> str | None:
    """Return our name of an axis; None if nothing identifies it."""
    about = coordinate.attrs
    units = str(about.get("units", "")).lower()
    standard = str(about.get("standard_name", "")).lower()
    if standard in _FOREIGN:
        raise ConfigError(
            f"{format_path(path)}: {dim} is a {standard}, no latitude or longitude: {_REGRID}"
        )
    if " since " in units:
        return "time"
    if standard or units in _DEGREES:
        return _STANDARD.get(standard, _DEGREES.get(units))
    return _LETTERS.get(str(about.get("axis", "")).upper(), _NAMES.get(dim.lower()))


def _read_knots(path: Path, kind: str, dim: str, coordinate: "xarray.DataArray") -> CoordinateAxis:
    """Return the knots of one axis in our units, increasing where they may be reversed."""
    if kind == "time":
        return _read_times(path, dim, coordinate)
    values = np.asarray(coordinate.values, np.float64)
    units = str(coordinate.attrs.get("units", "")).strip().lower()
    degrees = kind != "depth" and _is_degrees(path, kind, dim, coordinate)
    if not degrees:
        if units not in METRES:
            raise ConfigError(
                f"{format_path(path)}: {dim} has the units {format_value(units)}: must be m or km"
                + ("" if kind == "depth" else ", degrees_north or degrees_east")
            )
        values = values * METRES[units]
    if kind == "depth" and _is_upward(coordinate, values):
        values = -values
    if degrees and kind == "x":
        values = np.unwrap(values, period=360.0)
    _require_rising(path, dim, values, either=True)
    largest = {"y": 90.0, "x": 720.0}.get(kind, np.inf) if degrees else np.inf
    if np.abs(values).max() > largest:
        raise ConfigError(
            f"{format_path(path)}: {dim} goes from {values.min():g} to {values.max():g} degrees; "
            "correct it, or its units"
        )
    return CoordinateAxis(knots=np.sort(values), degrees=degrees, turned=values[0] > values[-1])


def _is_degrees(path: Path, kind: str, dim: str, coordinate: "xarray.DataArray") -> bool:
    """Return whether a horizontal axis is one of latitudes or longitudes.

    Raises:
        ConfigError: it is in degrees, and nothing identifies it as latitude or longitude.
    """
    about = coordinate.attrs
    units = str(about.get("units", "")).strip().lower()
    if units not in ("degrees", "degree", *_DEGREES):
        return False
    beginning = {"y": "lat", "x": "lon"}[kind]
    names = (dim, str(about.get("long_name", "")), str(about.get("standard_name", "")))
    is_named = any(name.lower().startswith(beginning) for name in names)
    if _DEGREES.get(units, kind) != kind or not (units in _DEGREES or is_named):
        raise ConfigError(
            f"{format_path(path)}: {dim} has the units {format_value(units)}: true latitudes have "
            f"degrees_north, longitudes degrees_east; say so in the file (ncatted), or: {_REGRID}"
        )
    return True


def _require_frame(
    path: Path,
    data: "xarray.Dataset",
    array: "xarray.DataArray",
    axes: Mapping[str, tuple[str, CoordinateAxis]],
) -> None:
    """Require that a variable's axes and components are east and north, or both of one plane.

    Raises:
        ConfigError: they are not, or the file does not state it.
    """
    (y, axis), (x, _) = axes["y"], axes["x"]
    mapping = _grid_mapping(path, data, array, is_needed=not axis.degrees)
    if mapping not in (None, "latitude_longitude" if axis.degrees else "transverse_mercator"):
        raise ConfigError(
            f"{format_path(path)}: {array.name} stands on the grid mapping {mapping}: {_REGRID}"
        )
    if axis.degrees:
        return
    flat = [str(name) for name in array.coords if array.coords[name].ndim == 2]
    if mapping is None and flat:
        raise ConfigError(
            f"{format_path(path)}: {y} and {x} are in metres of a map projection that it does not "
            f"describe (grid_mapping): {_REGRID}"
        )
    standard = str(array.attrs.get("standard_name", ""))
    is_projected = mapping is not None or "standard_name" in {**data[y].attrs, **data[x].attrs}
    if is_projected and ("eastward" in standard or "northward" in standard):
        raise ConfigError(
            f"{format_path(path)}: {array.name} is {standard}, and {y} and {x} are those of a map "
            "projection, not east and north: interpolate it to latitude and longitude "
            "(cdo remapbil)"
        )


def _grid_mapping(
    path: Path, data: "xarray.Dataset", array: "xarray.DataArray", *, is_needed: bool
) -> str | None:
    """Return the grid_mapping_name of a variable; None if it has none.

    Args:
        path: path of the file.
        data: dataset of the file.
        array: the variable.
        is_needed: whether a mapping that the variable names must be in the file.
    """
    about = array.attrs.get("grid_mapping", array.encoding.get("grid_mapping"))
    if about is None:
        return None
    name = str(about).split(":")[0].strip()
    attributes = data[name].attrs if name in data.variables else {}
    mapping = attributes.get("grid_mapping_name")
    if mapping is None and is_needed:
        raise ConfigError(
            f"{format_path(path)}: {array.name} has the grid mapping {format_value(name)}, which "
            "the file does "
            "not describe by a grid_mapping_name; give a file that does"
        )
    return None if mapping is None else str(mapping)


def _is_upward(coordinate: "xarray.DataArray", values: np.ndarray) -> bool:
    """Return whether a vertical axis counts upwards: by its attribute, else by its sign."""
    positive = str(coordinate.attrs.get("positive", "")).lower()
    if positive in ("up", "down"):
        return positive == "up"
    if str(coordinate.attrs.get("standard_name", "")).startswith(_HEIGHTS):
        return True
    return bool(np.all(values <= 0.0) and np.any(values < 0.0))


def _read_times(path: Path, dim: str, coordinate: "xarray.DataArray") -> CoordinateAxis:
    """Return the knots of a time axis, s after the first.

    Raises:
        ConfigError: they are missing, decrease, or use a calendar whose days are not those of UTC.
    """
    import xarray

    about = {key: format_value(str(coordinate.attrs.get(key, ""))) for key in ("units", "calendar")}
    rule = 'times must be as in "hours since 2024-01-01", in the standard calendar'
    try:
        numbers = xarray.Dataset({dim: coordinate.variable})
        values = xarray.decode_cf(numbers, decode_timedelta=False)[dim].values
    except (ValueError, OverflowError, TypeError) as error:
        raise ConfigError(
            f"{format_path(path)}: {dim} has the units {about['units']} and cannot be read "
            f"({_format_reason(error.__cause__ or error)}): {rule}"
        ) from error
    if not np.issubdtype(values.dtype, np.datetime64):
        raise ConfigError(
            f"{format_path(path)}: {dim} has the units {about['units']} and the calendar "
            f"{about['calendar']}: {rule}"
        )
    if np.any(np.isnat(values)):
        raise ConfigError(f"{format_path(path)}: {dim} has missing times; cut them off")
    seconds = (values - values[0]) / np.timedelta64(1, "s")
    _require_rising(path, dim, seconds, either=False)
    return CoordinateAxis(knots=seconds, begin=values[0])


def _require_rising(path: Path, dim: str, knots: np.ndarray, *, either: bool) -> None:
    step = np.diff(knots)
    rises = np.all(step > 0) or (either and np.all(step < 0))
    if not (np.all(np.isfinite(knots)) and rises):
        wrong = np.flatnonzero(~(step > 0))
        where = f" (at number {int(wrong[0]) + 1}, from 0)" if len(wrong) else ""
        raise ConfigError(
            f"{format_path(path)}: {dim} must {'rise or fall' if either else 'rise'} from each "
            "value to "
            f"the next{where}; sort the file along it"
        )


def _order_axes(
    array: "xarray.DataArray", axes: Mapping[str, tuple[str, CoordinateAxis]]
) -> np.ndarray:
    """Return the values [y, x, depth, time] of a variable, with increasing axes."""
    kinds = [kind for kind in AXES if kind in axes]
    order = [axes[kind][0] for kind in kinds]
    alone = {dim: 0 for dim in array.dims if dim not in order}
    values: np.ndarray = np.asarray(array.isel(alone).transpose(*order).values, np.float64)
    turned = [slice(None, None, -1 if axes[kind][1].turned else 1) for kind in kinds]
    whole = [slice(None) if kind in axes else None for kind in AXES]
    return values[tuple(turned)][tuple(whole)]


def _unit_factor(path: Path, array: "xarray.DataArray", factors: Mapping[str, float]) -> float:
    units = " ".join(str(array.attrs.get("units", "")).lower().split())
    if units not in factors:
        some = "m s-1, cm s-1, km h-1 or knots" if factors is PER_SECOND else "m or km"
        raise ConfigError(
            f"{format_path(path)}: {array.name} has the units {format_value(units)}: must be "
            f"{some}; say them "
            "in the file (ncatted -a units)"
        )
    return factors[units]


def _format_axes(array: "xarray.DataArray") -> str:
    return ", ".join(f"{dim} ({n})" for dim, n in zip(array.dims, array.shape, strict=True))
