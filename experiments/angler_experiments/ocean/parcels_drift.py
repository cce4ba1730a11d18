"""Particles of `drift` by OceanParcels, in an environment of its own.

    python -m venv parcels && parcels/bin/pip install "parcels>=4" netCDF4
    parcels/bin/python experiments/angler_experiments/ocean/parcels_drift.py runs/drift

Reads the positions and the field of ``drift`` from the folder and writes ``parcels.npz``: tracks of
the particles that stayed clear of land. The field is on a plane (``mesh="flat"``) with the water
extended into land, as ours is: the comparison is of interpolation and integration.
"""

import argparse
import importlib
from pathlib import Path
from typing import Any

import numpy as np
import xarray

STEP_S, STEPS_PER_SAMPLE, HOURS = 300.0, 12, 24

parcels = importlib.import_module("parcels")
"""Module of Parcels, not a dependency of this package."""


def build_fieldset(path: Path) -> Any:
    """Build the field of the folder for Parcels."""
    data = xarray.open_dataset(path).load()
    about = {
        "time": {"axis": "T", "standard_name": "time"},
        "depth": {"axis": "Z", "positive": "down", "units": "m"},
        "lat": {"axis": "Y", "units": "m"},
        "lon": {"axis": "X", "units": "m"},
    }
    for name, attrs in about.items():
        data[name].attrs.update(attrs)
    grid = parcels.convert.copernicusmarine_to_sgrid(fields={"U": data["U"], "V": data["V"]})
    return parcels.FieldSet.from_sgrid_conventions(grid, mesh="flat")


def main() -> None:
    """Advect and write the tracks."""
    parser = argparse.ArgumentParser(description="The particles of drift, by OceanParcels.")
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    fields = build_fieldset(folder / "flat.nc")
    with np.load(folder / "tracks.npz") as stored:
        begin = stored["begin"][stored["clear"]]
    start = fields.time_interval.left
    particles = parcels.ParticleSet(
        fields,
        t=np.full(len(begin), start),
        z=-begin[:, 2],
        y=begin[:, 1],
        x=begin[:, 0],
    )
    tracks = [begin]
    for _ in range(HOURS):
        particles.execute(
            parcels.kernels.AdvectionRK4,
            dt=np.timedelta64(int(STEP_S), "s"),
            runtime=np.timedelta64(int(STEPS_PER_SAMPLE * STEP_S), "s"),
            verbose_progress=False,
        )
        positions = np.stack([particles.x, particles.y, -np.asarray(particles.z)], axis=1)
        tracks.append(positions)
    np.savez(folder / "parcels.npz", tracks=np.array(tracks), version=parcels.__version__)
    print(folder / "parcels.npz")


if __name__ == "__main__":
    main()
