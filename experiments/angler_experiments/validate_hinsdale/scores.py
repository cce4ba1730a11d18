"""Errors of simulated and reference motion against the recorded one."""

from collections.abc import Mapping
from operator import itemgetter
from typing import TypedDict

import numpy as np

from angler_experiments.validate_hinsdale.tracks import STEP_S, Track

type Array = np.ndarray

HEAVE_S = 10.0
"""Time over which heave is judged."""


class RunScores(TypedDict):
    """Errors of one run, NaN where nothing is predicted; angles rad, lengths m."""

    roll: float
    pitch: float
    yaw: float
    heave: float
    """Over the first `HEAVE_S`."""
    heave_end: float
    """At `HEAVE_S` or the end, whichever is earlier."""
    drift_end: float
    """Horizontal, there."""
    imu_roll: float
    """Against the inertial unit, each with its median taken off: offsets of mounting differ."""
    imu_pitch: float


def score_run(track: Track, angles_rad: Array, p_m: Array) -> RunScores:
    """Return root mean square errors of a motion [n or more, 3] against a run.

    NaN in a motion means no prediction of that coordinate.
    """
    n = len(track.t_s)
    angles = angles_rad[:n] - track.angles_rad
    angles[:, 2] = (angles[:, 2] + np.pi) % (2.0 * np.pi) - np.pi
    shift = p_m[:n] - track.p_m
    recorded = np.flatnonzero(np.isfinite(track.p_m[:, 0]))
    early = recorded[recorded * STEP_S <= HEAVE_S]
    imu = angles_rad[:n, :2] - track.imu_rad
    imu = imu - np.nanmedian(imu, axis=0)
    return {
        "roll": _rms(angles[recorded, 0]),
        "pitch": _rms(angles[recorded, 1]),
        "yaw": _rms(angles[recorded, 2]),
        "heave": _rms(shift[early, 2]),
        "heave_end": float(shift[early[-1], 2]),
        "drift_end": float(np.linalg.norm(shift[early[-1], :2])),
        "imu_roll": _rms(imu[np.isfinite(imu[:, 0]), 0]),
        "imu_pitch": _rms(imu[np.isfinite(imu[:, 1]), 1]),
    }


def median_scores(scores: Mapping[str, RunScores]) -> dict[str, float]:
    """Return medians over runs of the absolute errors."""
    names = list(RunScores.__annotations__)
    table = np.abs([itemgetter(*names)(run) for run in scores.values()])
    return dict(zip(names, np.median(table, axis=0).tolist(), strict=True))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
