"""Bands of a fleet of sampled parameters, and how often they hold the recording."""

from collections.abc import Sequence
from typing import TypedDict

import jax
import numpy as np

from angler_experiments.validate_hinsdale.batch import Motion, RunBatch, simulate_run
from angler_experiments.validate_hinsdale.parameters import apply_parameters
from angler_experiments.validate_hinsdale.tracks import Track
from angler_experiments.validate_hinsdale.vehicle import CampaignVehicle

type Array = np.ndarray

LEVELS = (0.5, 0.95)
COORDINATES = ("roll", "pitch", "heave")


class Coverage(TypedDict):
    """Fraction of recorded values within the bands, over all runs and times."""

    roll: float
    pitch: float
    heave: float


@jax.jit
def simulate_samples(vehicle: CampaignVehicle, vectors: jax.Array, batch: RunBatch) -> Motion:
    """Return motions [sample, run, n] for parameter vectors [sample, k]."""

    def one(vector: jax.Array) -> Motion:
        sampled = apply_parameters(vehicle, vector)
        return jax.vmap(simulate_run, (None, 0))(sampled, batch)

    return jax.vmap(one)(vectors)


def coordinates_of(motion: Motion) -> Array:
    """Return roll, pitch and heave [..., 3] of a motion."""
    return np.concatenate(
        [np.asarray(motion.angles_rad)[..., :2], np.asarray(motion.p_m)[..., 2:]], axis=-1
    )


def recorded_coordinates(track: Track, n: int) -> Array:
    """Return recorded roll, pitch and heave [n, 3]; NaN where nothing is recorded."""
    recorded = np.concatenate([track.angles_rad[:, :2], track.p_m[:, 2:]], axis=1)
    return np.concatenate([recorded, np.full((n - len(recorded), 3), np.nan)])


def out_of_bag_errors(tracks: Sequence[Track], simulated: Array, counts: Array) -> Array:
    """Return errors (recorded minus predicted) [run, n, 3] of runs by samples without them.

    Gaps are filled by interpolation and the last error holds on, so that each row is a path that
    can be added to another run's prediction.

    Args:
        tracks: runs that identified the samples.
        simulated: [sample, run, n, 3] roll, pitch, heave.
        counts: [sample, run] how often each run was in each sample.
    """
    n = simulated.shape[2]
    errors = []
    for i, track in enumerate(tracks):
        predicted = simulated[counts[:, i] == 0.0, i].mean(axis=0)
        errors.append(_fill(recorded_coordinates(track, n) - predicted))
    return np.stack(errors)


def predictive_paths(simulated: Array, errors: Array, rng: np.random.Generator) -> Array:
    """Return paths [sample, n, 3] of a run: each sample with the error of a random training run.

    Args:
        simulated: [sample, n, 3] of one run.
        errors: [run, n, 3] of `out_of_bag_errors`.
        rng: chooses the training runs.
    """
    chosen = rng.integers(len(errors), size=len(simulated))
    paths: Array = simulated + errors[chosen]
    return paths


def band(paths: Array, level: float) -> tuple[Array, Array]:
    """Return the lower and upper end [n, 3] of the central band of paths [sample, n, 3]."""
    low, high = np.quantile(paths, [0.5 - 0.5 * level, 0.5 + 0.5 * level], axis=0)
    return low, high


def coverage(tracks: Sequence[Track], paths: Sequence[Array], level: float) -> Coverage:
    """Return which fraction of the recorded values the bands hold; runs count the same."""
    fractions = []
    for track, of_run in zip(tracks, paths, strict=True):
        recorded = recorded_coordinates(track, of_run.shape[1])
        low, high = band(of_run, level)
        is_recorded = np.isfinite(recorded[:, 0])
        is_held = (recorded >= low) & (recorded <= high)
        fractions.append(is_held[is_recorded].mean(axis=0))
    roll, pitch, heave = np.mean(fractions, axis=0).tolist()
    return {"roll": roll, "pitch": pitch, "heave": heave}


def _fill(errors: Array) -> Array:
    """Return errors [n, 3] with gaps interpolated and ends held."""
    is_there = np.isfinite(errors[:, 0])
    index = np.arange(len(errors))
    return np.stack(
        [np.interp(index, index[is_there], column[is_there]) for column in errors.T], axis=1
    )
