"""Figures of recorded and predicted motion, run by run."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from angler_experiments.validate_hinsdale import bands
from angler_experiments.validate_hinsdale.references import Prediction
from angler_experiments.validate_hinsdale.tracks import Track

type Array = np.ndarray

RUNS_PER_FIGURE = 7
STYLES = {
    "balance": ("tab:green", ":"),
    "wu2018": ("tab:orange", "--"),
    "hinsdale2023_authors": ("tab:purple", "-."),
    "hinsdale2023_identified": ("tab:red", "-"),
}
"""Colour and line of the plotted predictions."""
EXAMPLES = ("traj014-1", "traj_alt_008-1")
"""A good and a bad run of the test half, for a figure of their own."""


def plot_overlays(
    out: Path,
    tracks: Sequence[Track],
    predictions: Mapping[str, Sequence[Prediction]],
    paths: Sequence[Array] | None,
    training: set[str],
) -> list[Path]:
    """Plot roll, pitch, heave and joints of all runs; return the files.

    Args:
        out: folder of the figures.
        tracks: runs.
        predictions: by name, one for each run.
        paths: for each run [sample, n, 3] of a fleet, for its 95 % band.
        training: stems of the training half.
    """
    files = []
    for first in range(0, len(tracks), RUNS_PER_FIGURE):
        chosen = range(first, min(first + RUNS_PER_FIGURE, len(tracks)))
        figure = Figure(figsize=(17, 2.6 * RUNS_PER_FIGURE), layout="tight")
        grid = figure.subplots(RUNS_PER_FIGURE, 4, squeeze=False)
        _plot_rows(grid, chosen, tracks, predictions, paths, training)
        for axes in grid[len(chosen) :].ravel():
            axes.set_axis_off()
        files.append(out / f"runs_{first // RUNS_PER_FIGURE}.png")
        figure.savefig(files[-1], dpi=75)
    examples = [i for i, track in enumerate(tracks) if track.stem in EXAMPLES]
    if examples:
        figure = Figure(figsize=(13, 2.6 * len(examples)), layout="tight")
        grid = figure.subplots(len(examples), 4, squeeze=False)
        _plot_rows(grid, examples, tracks, predictions, paths, training)
        files.append(out / "examples.png")
        figure.savefig(files[-1], dpi=80)
    return files


def _plot_rows(
    grid: Array,
    chosen: Sequence[int],
    tracks: Sequence[Track],
    predictions: Mapping[str, Sequence[Prediction]],
    paths: Sequence[Array] | None,
    training: set[str],
) -> None:
    """Plot the chosen runs, one in each row of a grid of axes [row, 4]."""
    for row, i in zip(grid, chosen, strict=False):
        of_run = {name: made[i] for name, made in predictions.items() if name in STYLES}
        _plot_run(row, tracks[i], of_run, None if paths is None else paths[i])
        half = "training" if tracks[i].stem in training else "test"
        row[0].set_title(f"{tracks[i].stem} ({half})", fontsize=10)
    grid[0][0].legend(fontsize=7)


def _plot_run(
    row: Sequence[Axes], track: Track, predictions: Mapping[str, Prediction], paths: Array | None
) -> None:
    n = len(track.t_s)
    recorded = bands.recorded_coordinates(track, n)
    for k, (axes, label) in enumerate(
        zip(row, ("roll, rad", "pitch, rad", "height, m"), strict=False)
    ):
        axes.plot(track.t_s, recorded[:, k], "k.", ms=2, label="recorded")
        if k < 2:
            shift = np.nanmedian(recorded[:, k] - track.imu_rad[:, k])
            axes.plot(track.t_s, track.imu_rad[:, k] + shift, "0.6", lw=1, label="IMU, shifted")
        for name, made in predictions.items():
            values = np.concatenate([made.angles_rad[:n, :2], made.p_m[:n, 2:]], axis=1)
            colour, line = STYLES[name]
            axes.plot(track.t_s, values[:, k], color=colour, ls=line, lw=1, label=name)
        if paths is not None:
            low, high = bands.band(paths, 0.95)
            axes.fill_between(track.t_s, low[:n, k], high[:n, k], color="tab:red", alpha=0.15, lw=0)
        axes.set_ylabel(label)
    for k, joint in enumerate("edcb"):
        position = track.joint_rad[::2, k]
        row[3].plot(track.t_s, position - position[0], label=f"axis_{joint}", lw=1)
    row[3].set_ylabel("joints, rad")
