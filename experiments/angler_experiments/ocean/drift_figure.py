"""The picture of `drift`: tracks over the stream, and how far ours and others' end apart."""

import json
from pathlib import Path

import numpy as np
import xarray
from matplotlib.axes import Axes
from matplotlib.figure import Figure

HOUR = 4
"""Of the speeds behind the tracks: the tide runs."""


def plot_drift(folder: Path) -> Path:
    """Draw the tracks of a folder of `drift`; returns the file."""
    with np.load(folder / "tracks.npz") as stored:
        ours, clear, scipy = stored["ours"], stored["clear"], stored["scipy"]
    with xarray.open_dataset(folder / "flat.nc", engine="h5netcdf") as flat:
        part = flat.isel(time=HOUR, depth=1).load()
    with xarray.open_dataset(folder / "headland.nc", engine="h5netcdf") as file:
        wet = np.isfinite(file["uo"].isel(time=HOUR, depth=1).values)
    results = json.loads((folder / "drift.json").read_text())
    figure = Figure(figsize=(10, 4.2), layout="tight")
    left, right = figure.subplots(1, 2, width_ratios=(1.5, 1))
    x, y = part["lon"].values / 1e3, part["lat"].values / 1e3
    speed = np.where(wet, np.hypot(part["U"], part["V"]), np.nan)
    left.set_facecolor("0.75")
    speed_mesh = left.pcolormesh(x, y, speed, cmap="Blues", vmin=0, shading="nearest")
    figure.colorbar(speed_mesh, ax=left, label=f"speed at hour {HOUR}, m/s")
    plotted = np.flatnonzero(clear)[:: max(1, int(clear.sum()) // 60)]
    left.plot(ours[:, plotted, 0] / 1e3, ours[:, plotted, 1] / 1e3, color="tab:red", lw=0.6)
    left.plot(*(ours[0, plotted, k] / 1e3 for k in (0, 1)), "k.", ms=2)
    left.set(xlabel="east, km", ylabel="north, km", aspect="equal")
    left.set_title(f"{len(plotted)} of {int(clear.sum())} particles, 24 h; land grey", fontsize=10)
    _plot_distances(right, "SciPy", ours[:, : scipy.shape[1]], scipy, clear[: scipy.shape[1]])
    if "parcels" in results:
        with np.load(folder / "parcels.npz") as stored:
            tracks = stored["tracks"]
        is_all = np.ones(tracks.shape[1], bool)
        _plot_distances(
            right, f"Parcels {results['parcels']['version']}", ours[:, clear], tracks, is_all
        )
    right.set(xlabel="hours", ylabel="distance from ours, m", yscale="log", xlim=(0, 24))
    right.axhline(1.0, color="0.5", ls=":", lw=1)
    right.legend(fontsize=8)
    right.set_title("median, and the farthest of all (dashed)", fontsize=10)
    path = folder / "drift.png"
    figure.savefig(path, dpi=110)
    return path


def _plot_distances(
    axes: Axes, name: str, ours: np.ndarray, theirs: np.ndarray, clear: np.ndarray
) -> None:
    """How far two sets of tracks are apart, hour by hour."""
    distance_m = np.linalg.norm((ours - theirs)[1:, clear, :2], axis=-1)
    hours = np.arange(1, len(distance_m) + 1)
    (line,) = axes.plot(hours, np.median(distance_m, axis=1), label=name)
    axes.plot(hours, distance_m.max(axis=1), color=line.get_color(), ls="--", lw=1)
