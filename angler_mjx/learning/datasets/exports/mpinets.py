"""HDF5 layout of motion policy networks (Fishman et al. 2022), for points in water.

``global_solutions`` [n, T, 4] are flights of robots that arrived, x, y, z and heading at T times
evenly spaced; rock and obstacles at the start are cuboids, cylinders and, beyond that layout,
spheres, padded with zeros to the largest number.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from angler_mjx.errors import UnsupportedError
from angler_mjx.learning.datasets.dataset import Dataset
from angler_mjx.learning.datasets.exports import flights
from angler_mjx.world.obstacles.types import BOX, CAPSULE, SPHERE

if TYPE_CHECKING:
    import h5py

SOLUTION_POINTS = 50
"""Number of points of a solution, as in the original data."""


def write_dataset(data: Dataset, out: Path, action: str, progress: Callable[[int], None]) -> None:
    """Write a file for each split, ``train.hdf5`` and so on; see `parquet.write_dataset`.

    Raises:
        ConfigError: a file is damaged.
        UnsupportedError: h5py is not installed.
        OSError: writing failed.
    """
    try:
        import h5py
    except ImportError as error:
        raise UnsupportedError("h5py is not installed: pip install 'angler-mjx[export]'") from error
    splits = sorted(set(data.index["split"].to_pylist()))
    max_counts = _max_shape_counts(data)
    files = {name: h5py.File(out / f"{name}.hdf5", "w") for name in splits}
    try:
        for name, file in files.items():
            _create_arrays(file, max_counts, name)
        current_episode, scene = -1, {}
        for number, flight in enumerate(flights.iterate_flights(data, action), 1):
            if flight.episode != current_episode:
                current_episode, scene = (
                    flight.episode,
                    build_shapes(data.episode(flight.episode).environment),
                )
            if flight.arrived:
                _append_rows(
                    files[flight.split], {"global_solutions": resample_flight(flight), **scene}
                )
            progress(number)
    finally:
        for file in files.values():
            file.close()


def resample_flight(flight: flights.ExportedFlight) -> np.ndarray:
    """Resample a flight to [POINTS, 4]: x, y, z, m, and heading, rad, evenly in time."""
    time_s = np.linspace(flight.time_s[0], flight.time_s[-1], SOLUTION_POINTS)
    w, x, y, z = flight.state[:, 3:7].T
    heading = np.unwrap(np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))
    rows = [*flight.state[:, :3].T, heading]
    return np.stack([np.interp(time_s, flight.time_s, row) for row in rows], axis=-1)


def build_shapes(environment: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return rock and obstacles of a world at its start, by the names of layout, [count, ...]."""
    cell = float(environment["grid/cell_m"]) if "grid/cell_m" in environment else 1.0
    cells = np.argwhere(environment["grid/occupied"])
    centres = environment["grid/origin_m"] + cell * (cells + 0.5)
    upright = np.tile([1.0, 0.0, 0.0, 0.0], (len(cells), 1))
    kind = np.asarray(environment.get("obstacles/kind", np.zeros(0, int)))
    exists = np.asarray(environment.get("obstacles/exists", np.zeros(0, bool)))
    size = np.asarray(environment.get("obstacles/size_m", np.zeros((0, 3))))
    position_m = np.asarray(environment.get("obstacles/p0", np.zeros((0, 3))))
    quaternion = np.asarray(environment.get("obstacles/q0", np.zeros((0, 4))))
    box, rod, ball = (exists & (kind == shape_kind) for shape_kind in (BOX, CAPSULE, SPHERE))
    return {
        "cuboid_centers": np.concatenate([centres, position_m[box]]),
        "cuboid_dims": np.concatenate([np.full((len(cells), 3), cell), 2.0 * size[box]]),
        "cuboid_quaternions": np.concatenate([upright, quaternion[box]]),
        "cylinder_centers": position_m[rod],
        "cylinder_radii": size[rod, :1],
        "cylinder_heights": 2.0 * (size[rod, 1:2] + size[rod, :1]),
        "cylinder_quaternions": quaternion[rod],
        "sphere_centers": position_m[ball],
        "sphere_radii": size[ball, :1],
    }


_TAILS = {"centers": 3, "dims": 3, "quaternions": 4, "radii": 1, "heights": 1}


ATTRIBUTES = {
    "solutions": {"unit": "m, m, m, rad", "description": "x, y, z and heading, evenly in time"},
    "centers": {"unit": "m", "description": "centres, world frame; zeros behind the last shape"},
    "dims": {"unit": "m", "description": "whole edges along the shape's own axes"},
    "quaternions": {"unit": "1", "description": "attitudes wxyz, from the shape's frame to W"},
    "radii": {"unit": "m", "description": "radii"},
    "heights": {"unit": "m", "description": "whole heights along z of the shape's frame"},
}
"""Attributes of every array, by the last word of its name."""


def _max_shape_counts(data: Dataset) -> dict[str, int]:
    """Return the number of rows that each kind of shape needs."""
    max_counts: dict[str, int] = {}
    for i in range(len(data)):
        for name, rows in build_shapes(data.episode(i).environment).items():
            max_counts[name] = max(max_counts.get(name, 1), len(rows))
    return max_counts


def _create_arrays(file: "h5py.File", max_counts: Mapping[str, int], split: str) -> None:
    file.attrs["split"] = split
    file.attrs["frames"] = "world x east, y north, z up, m; quaternions wxyz"
    array_shapes = {"global_solutions": (SOLUTION_POINTS, 4)}
    array_shapes |= {
        name: (rows, _TAILS[name.rpartition("_")[2]]) for name, rows in max_counts.items()
    }
    for name, tail in array_shapes.items():
        array = file.create_dataset(
            name, (0, *tail), "f8", maxshape=(None, *tail), chunks=(16, *tail), compression="gzip"
        )
        for key, text in ATTRIBUTES[name.rpartition("_")[2]].items():
            array.attrs[key] = text


def _append_rows(file: "h5py.File", rows: Mapping[str, np.ndarray]) -> None:
    for name, values in rows.items():
        stored = file[name]
        stored.resize(len(stored) + 1, axis=0)
        padded = np.zeros(stored.shape[1:])
        padded[: len(values)] = values
        stored[-1] = padded
