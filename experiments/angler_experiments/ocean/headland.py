"""Tidal stream around a headland, in the format of an ocean model's file.

    python -m angler_experiments.ocean.headland headland.nc

A coast runs from west to east, and a round headland of 2 km stands out from it. The stream is that
of a potential flow past a cylinder, turned by the tidal constituents M2 and S2; in its lee, on
either side by turns, an eddy. Both come from stream functions that are constant along the coast, so
no water crosses it; deeper water is slower and turns later. Nothing is sampled: the numbers are
always the same.
"""

import argparse
from pathlib import Path

import numpy as np
import xarray

LATITUDE, LONGITUDE = 50.50, -2.45
"""Position of the middle of the coast."""
SPACING_M = 500.0
RADIUS_M = 2000.0
"""Radius of the headland."""
STREAM_MPS = 0.25
"""Greatest speed of the tide, far from the headland."""
DEPTHS_M = (0.5, 2.0, 5.0, 10.0, 15.0, 22.0, 30.0, 40.0)
HOURS = 25
BEGIN = "2024-06-01T00:00:00"
_M2, _S2 = 2 * np.pi / (12.4206012 * 3600), 2 * np.pi / (12.0 * 3600)


def sea_floor_m(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the depth of the sea floor, m, by metres east and north; negative on land."""
    distance_m = np.minimum(y, np.hypot(x, y) - RADIUS_M)
    depth: np.ndarray = np.where(
        distance_m > 0, 4.0 + 44.0 * np.tanh(np.maximum(distance_m, 0.0) / 5000.0), -5.0
    )
    return depth


def stream_m2ps(x: np.ndarray, y: np.ndarray, depth_m: float, time_s: np.ndarray) -> np.ndarray:
    """Return stream function, m^2/s; the velocity is its derivative by y, and minus that by x."""
    delayed_s = time_s - 40.0 * depth_m
    tide = 0.8 * np.cos(_M2 * delayed_s) + 0.2 * np.cos(_S2 * delayed_s - 0.6)
    square = np.maximum(x * x + y * y, 0.25 * RADIUS_M**2)
    potential = y * (1.0 - RADIUS_M**2 / square)
    total = STREAM_MPS * tide * potential
    for side in (-1.0, 1.0):
        # In the lee of the stream one and a half hours earlier.
        strength = np.maximum(side * np.cos(_M2 * (delayed_s - 5400.0)), 0.0)
        eddy_distance = np.hypot(x - side * 2.1 * RADIUS_M, y - 0.7 * RADIUS_M) / 1300.0
        wall = np.tanh(np.maximum(potential, 0.0) / 1500.0)
        total = total - side * 180.0 * strength * np.exp(-0.5 * eddy_distance**2) * wall
    slower = (1.0 - 0.5 * depth_m / DEPTHS_M[-1]) ** 0.5
    psi: np.ndarray = slower * total
    return psi


def build_dataset(n: int = 24) -> xarray.Dataset:
    """Build the field on ``n`` x ``n`` knots, in the packed form of published files."""
    x = SPACING_M * (np.arange(n) - 0.5 * (n - 1))
    y = SPACING_M * (np.arange(n) - 3.0)
    time_s = 3600.0 * np.arange(HOURS + 1)
    times, depths, north, east = np.meshgrid(time_s, DEPTHS_M, y, x, indexing="ij")
    step = 1.0
    u, v = np.empty_like(times), np.empty_like(times)
    for k, depth in enumerate(DEPTHS_M):
        t, at_y, at_x = times[:, k], north[:, k], east[:, k]
        u[:, k] = stream_m2ps(at_x, at_y + step, depth, t) - stream_m2ps(
            at_x, at_y - step, depth, t
        )
        v[:, k] = stream_m2ps(at_x - step, at_y, depth, t) - stream_m2ps(
            at_x + step, at_y, depth, t
        )
    floor = sea_floor_m(east[0, 0], north[0, 0])
    dry = depths > floor
    u, v = (np.where(dry, np.nan, part / (2 * step)) for part in (u, v))
    latitude = LATITUDE + y / 111_240.0
    longitude = LONGITUDE + x / (111_320.0 * np.cos(np.radians(LATITUDE)))
    begin = np.datetime64(BEGIN)
    axes = ("time", "depth", "latitude", "longitude")

    def velocity(
        values: np.ndarray, name: str
    ) -> tuple[tuple[str, ...], np.ndarray, dict[str, str]]:
        about = {"standard_name": f"{name}_sea_water_velocity", "units": "m s-1"}
        return axes, values, about

    return xarray.Dataset(
        {
            "uo": velocity(u, "eastward"),
            "vo": velocity(v, "northward"),
            "deptho": (
                axes[2:],
                np.where(floor > 0, floor, np.nan),
                {"standard_name": "sea_floor_depth_below_sea_level", "units": "m"},
            ),
        },
        coords={
            "time": ("time", begin + time_s.astype("timedelta64[s]"), {"standard_name": "time"}),
            "depth": (
                "depth",
                np.asarray(DEPTHS_M),
                {"standard_name": "depth", "units": "m", "positive": "down"},
            ),
            "latitude": (
                "latitude",
                latitude,
                {"standard_name": "latitude", "units": "degrees_north"},
            ),
            "longitude": (
                "longitude",
                longitude,
                {"standard_name": "longitude", "units": "degrees_east"},
            ),
        },
        attrs={"Conventions": "CF-1.11", "title": "Tidal stream around a headland, made by rule"},
    )


def write_dataset(path: Path, n: int = 24) -> Path:
    """Write the file, velocities as whole tenths of a millimetre per second.

    Args:
        path: path of the NetCDF file.
        n: number of knots along latitude and longitude.
    """
    packed = {
        "dtype": "int16",
        "scale_factor": 1e-4,
        "_FillValue": np.int16(-32768),
        "zlib": True,
        "complevel": 6,
        "shuffle": True,
    }
    build_dataset(n).to_netcdf(
        path,
        engine="h5netcdf",
        encoding={
            "uo": packed,
            "vo": packed,
            "deptho": {"dtype": "float32", "zlib": True},
            "time": {"units": f"hours since {BEGIN}", "dtype": "float64"},
        },
    )
    return path


def main() -> None:
    """Write the file of the command line."""
    parser = argparse.ArgumentParser(description="Write the file of a tidal stream.")
    parser.add_argument("path", type=Path)
    parser.add_argument("--knots", type=int, default=24, help="along latitude and longitude")
    arguments = parser.parse_args()
    print(write_dataset(arguments.path, arguments.knots))


if __name__ == "__main__":
    main()
