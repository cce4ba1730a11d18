"""A velocity field on a grid, as programs hold it: one for all worlds.

Values of water are extended onto land and missing knots, so that interpolation is never with still
water: each dry knot has the values of the nearest wet knot of its depth, and a depth without water
has those of the depth above. A knot is dry if any of its times is missing.
"""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np

from angler_kernels.gridded_field import MAX_STATIC_KNOTS, GridAxis
from angler_mjx.errors import ConfigError
from angler_mjx.files import format_path
from angler_mjx.quantities import MAX_SPEED_MPS
from angler_mjx.world.ocean import cf
from angler_mjx.world.ocean.cf import VariableRequest

_EVEN = 1e-6
"""Relative tolerance within which the steps of an axis count as equal."""


@dataclass(frozen=True, kw_only=True, eq=False)
class OceanField:
    """Velocities on a grid; fields with equal numbers are equal."""

    values: np.ndarray
    """[y, x, depth, time, component] float32, m/s: east, north and, where there are three, up."""
    wet: np.ndarray
    """bool [y, x, depth] True for water."""
    knots: tuple[np.ndarray, ...]
    """Knots of y, x, depth and time, increasing, float64: degrees or metres, metres below the
    surface, seconds after the first."""
    degrees: bool
    """Whether y and x are latitude and longitude."""
    begin: str
    """First time, UTC, as in ISO 8601; empty where there is none."""
    source: str
    """File of the field; ignored in comparisons of fields."""
    names: tuple[str | None, str | None, str | None]
    """Names of u, v and w in the file, where given."""

    @cached_property
    def digest(self) -> str:
        """Return the hexadecimal digest of all data."""
        made = hashlib.sha256(repr((self.values.shape, self.degrees, self.begin)).encode())
        for array in (self.values, self.wet, *self.knots):
            made.update(np.ascontiguousarray(array).tobytes())
        return made.hexdigest()

    def __hash__(self) -> int:
        return hash(self.digest)

    def __eq__(self, other: object) -> bool:
        return self is other or (isinstance(other, OceanField) and self.digest == other.digest)

    def __repr__(self) -> str:
        return f"Field({'x'.join(map(str, self.values.shape))}, {self.digest[:12]})"

    @cached_property
    def shape(self) -> tuple[int, int, int, int, int]:
        """Return the number of knots along y, x, depth and time, and of components."""
        ny, nx, nz, nt, count = self.values.shape
        return ny, nx, nz, nt, count

    @cached_property
    def axes(self) -> tuple[GridAxis, ...]:
        """Return the axes in the form that programs use."""
        return tuple(even_axis(knots) for knots in self.knots)

    @cached_property
    def numbers(self) -> tuple[np.ndarray, ...]:
        """Return the flat arrays for lookups: the values, and the knots of long uneven axes."""
        uneven = [
            knots - knots[0]
            for axis, knots in zip(self.axes, self.knots, strict=True)
            if axis.step is None and not axis.knots
        ]
        return tuple(np.asarray(array, np.float32) for array in (self.values.reshape(-1), *uneven))


def even_axis(knots: np.ndarray) -> GridAxis:
    """Return an axis in the form that programs use: by its step, where that is constant."""
    if len(knots) == 1:
        return GridAxis(count=1, step=1.0)
    steps = np.diff(knots)
    mean = float((knots[-1] - knots[0]) / (len(knots) - 1))
    even = knots[0] + mean * np.arange(len(knots))
    is_even = np.max(np.abs(knots - even)) <= _EVEN * float(steps.min())
    if is_even:
        return GridAxis(count=len(knots), step=mean)
    few = tuple((knots - knots[0]).tolist()) if len(knots) <= MAX_STATIC_KNOTS else ()
    return GridAxis(count=len(knots), step=None, knots=few)


def load_field(path: str, names: Mapping[str, str | None]) -> OceanField:
    """Load the field of a file, once for each version of the file.

    Args:
        path: path of a NetCDF file.
        names: names of the variables u, v and w in it, where given.

    Raises:
        ConfigError: there is no such file, or it cannot be used; gives the reason.
        UnsupportedError: the library that reads it is not installed.
    """
    return _read_field(path, file_stamp(path), (names.get("u"), names.get("v"), names.get("w")))


def file_stamp(path: str) -> tuple[int, int]:
    """Return a stamp that changes with a file: modification time and size."""
    try:
        about = Path(path).stat()
    except (OSError, ValueError):
        return 0, 0  # reading the file reports the fault
    return about.st_mtime_ns, about.st_size


@lru_cache(maxsize=8)
def _read_field(
    path: str, _: tuple[int, int], names: tuple[str | None, str | None, str | None]
) -> OceanField:
    u, v, w = names
    wanted = (
        VariableRequest(key="u", name=u, standard=cf.EASTWARD, name_parts=cf.EAST_OR_X),
        VariableRequest(key="v", name=v, standard=cf.NORTHWARD, name_parts=cf.NORTH_OR_Y),
        VariableRequest(key="w", name=w, standard=cf.UPWARD, name_parts=("upward",), needed=False),
    )
    read = cf.read_variables(Path(path), wanted, cf.PER_SECOND)
    values = np.stack(read.parts, axis=-1)
    _require_slow(path, read, values)
    wet = np.all(np.isfinite(values), axis=(3, 4))
    if not wet.any():
        raise ConfigError(
            f"{format_path(path)}: no knot of it has a velocity at all times: all are missing "
            "(NaN); "
            "choose times that it covers"
        )
    y, x, depth, time = (read.axes[kind] for kind in cf.AXES)
    for axis, name in ((y, "latitude"), (x, "longitude")):
        if len(axis.knots) < 2:
            raise ConfigError(f"{format_path(path)}: has one {name} only; two are the least")
    knots = (y.knots, x.knots, depth.knots, time.knots)
    return OceanField(
        values=fill_land_values(values, wet, knots, y.degrees).astype(np.float32),
        wet=wet,
        knots=knots,
        degrees=y.degrees,
        begin="" if time.begin is None else str(time.begin.astype("datetime64[s]")),
        source=path,
        names=names,
    )


def _require_slow(path: str, read: cf.FileVariables, values: np.ndarray) -> None:
    """Require that no velocity exceeds the speed limit of currents.

    Args:
        path: path of the file.
        read: axes and names of the components.
        values: [y, x, depth, time, component] m/s; NaN where missing.

    Raises:
        ConfigError: a velocity does; gives position and time.
    """
    speed = np.sqrt(np.sum(np.square(values), axis=-1))
    fast = speed > MAX_SPEED_MPS
    if not fast.any():
        return
    at = tuple(int(i) for i in np.argwhere(fast)[0])
    y, x, depth, time = (read.axes[kind].knots[i] for kind, i in zip(cf.AXES, at, strict=True))
    position = (
        f"latitude {y:g}, longitude {x:g}" if read.axes["y"].degrees else f"y {y:g}, x {x:g} m"
    )
    begin = read.axes["time"].begin
    if begin is not None:
        moment = (begin + np.timedelta64(round(time), "s")).astype("datetime64[s]")
        position = f"{moment}, {position}"
    component = int(np.argmax(np.abs(values[at])))
    raise ConfigError(
        f"{format_path(path)}: {read.names[component]} = {values[at][component]:g} m/s at "
        f"{position}, "
        f"depth {depth:g} m: no water is faster than {MAX_SPEED_MPS:g} m/s (the fastest tidal "
        "stream "
        "makes 10 m/s); if the number stands for land, name it as _FillValue in the file "
        "(ncatted), else correct units or scale_factor"
    )


def fill_land_values(
    values: np.ndarray, wet: np.ndarray, knots: tuple[np.ndarray, ...], degrees: bool
) -> np.ndarray:
    """Return the values extended to every knot; see the module.

    Args:
        values: [y, x, depth, ...].
        wet: bool [y, x, depth]; one knot at least.
        knots: knots of y and x.
        degrees: whether they are latitudes and longitudes.
    """
    from scipy import ndimage  # 0.3 s of every start, for runs with fields of files only

    out = values.copy()
    shrink = np.cos(np.radians(np.mean(knots[0]))) if degrees else 1.0
    spacing = [float(np.mean(np.diff(knots[0]))), shrink * float(np.mean(np.diff(knots[1])))]
    for k in range(wet.shape[2]):
        if not wet[:, :, k].any():
            if k > 0:
                out[:, :, k] = out[:, :, k - 1]
            continue
        if wet[:, :, k].all():
            continue
        nearest = ndimage.distance_transform_edt(
            ~wet[:, :, k], sampling=spacing, return_distances=False, return_indices=True
        )
        out[:, :, k] = values[nearest[0], nearest[1], k]
    first = int(np.argmax(wet.any(axis=(0, 1))))
    out[:, :, :first] = out[:, :, first : first + 1]
    return out
