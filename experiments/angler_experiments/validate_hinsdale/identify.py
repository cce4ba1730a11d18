"""Identification of the vehicle's parameters from runs, with priors, by damped least squares.

Residuals of a run are the errors of roll, pitch, yaw and heave. Its mean error and its errors about
that mean are weighted apart: offsets between runs (another set of markers in view, another air
bubble) are errors of one number per run, not of each frame. Errors about the mean count as one
sample each `CORRELATION_S`.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from angler_experiments.validate_hinsdale.batch import RunBatch, simulate_run
from angler_experiments.validate_hinsdale.parameters import LABELS, apply_parameters
from angler_experiments.validate_hinsdale.tracks import STEP_S
from angler_experiments.validate_hinsdale.vehicle import CampaignVehicle

CORRELATION_S = 2.0
"""Time over which errors about a run's mean are taken to be the same: the pendulum's period."""
MEAN_SIGMA = (0.015, 0.015, 0.2, 0.03)
"""Standard deviation of a run's mean error of roll, pitch, yaw [rad] and heave [m]."""
ABOUT_SIGMA = (0.006, 0.006, 0.1, 0.03)
"""Standard deviation about that mean."""
ITERATIONS = 12
FIRST_DAMPING, DAMPING_DOWN, DAMPING_UP = 0.01, 0.2, 5.0
"""Damping of the first step, and factors on it after a better and a worse step."""
SAMPLES_AT_ONCE = 25
"""Bootstrap samples that are identified side by side; memory limits them."""


class BootstrapSample(NamedTuple):
    """Random part of samples of the posterior.

    Each has its runs, with repetition, and its prior mean, sampled from the prior: where the data
    say nothing, samples spread as the prior does.
    """

    counts: np.ndarray
    """[sample, run] how often each run is in each sample."""
    center: np.ndarray
    """[sample, k] prior mean."""


class Fit(NamedTuple):
    """Result of an identification."""

    vector: jax.Array
    """[k] standardised parameters at the highest posterior density."""
    cost: jax.Array
    """[] half the weighted sum of squares, prior included."""
    information: jax.Array
    """[k, k] Fisher information of the runs, without the prior."""


def run_residuals(
    vector: jax.Array, vehicle: CampaignVehicle, batch: RunBatch, run: jax.Array
) -> jax.Array:
    """Return the weighted residuals [m] of one run [] of a batch, for parameters [k]."""
    one = jax.tree.map(lambda x: x[run], batch)
    motion = simulate_run(apply_parameters(vehicle, vector), one)
    error = jnp.concatenate(
        [motion.angles_rad - one.angles_rad, (motion.p_m - one.p_m)[:, 2:]], axis=1
    )
    yaw = jnp.arctan2(jnp.sin(error[:, 2]), jnp.cos(error[:, 2]))
    error = error.at[:, 2].set(yaw)
    error = jnp.where(one.is_recorded[:, None], error, 0.0)
    n = one.is_recorded.sum()
    mean = error.sum(axis=0) / n
    about = jnp.where(one.is_recorded[:, None], error - mean, 0.0)
    weight = jnp.sqrt(STEP_S / CORRELATION_S)
    return jnp.concatenate(
        [
            mean / jnp.array(MEAN_SIGMA),
            (weight * about / jnp.array(ABOUT_SIGMA)).ravel(),
        ]
    )


def normal_equations(
    vector: jax.Array, vehicle: CampaignVehicle, batch: RunBatch
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return cost [run], gradient [run, k] and information [run, k, k] of the runs."""

    def one_run(run: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        def residuals(x: jax.Array) -> jax.Array:
            return run_residuals(x, vehicle, batch, run)

        residual = residuals(vector)
        basis = jnp.eye(vector.shape[0], dtype=vector.dtype)
        jacobian = jax.vmap(lambda tangent: jax.jvp(residuals, (vector,), (tangent,))[1])(basis)
        information = jnp.dot(jacobian, jacobian.T, precision="highest")
        return (
            0.5 * jnp.sum(residual**2),
            jnp.dot(jacobian, residual, precision="highest"),
            information,
        )

    return jax.vmap(one_run)(jnp.arange(batch.is_recorded.shape[0]))


class _Iterate(NamedTuple):
    """State of Levenberg and Marquardt's method; see `Fit`."""

    fit: Fit
    slope: jax.Array
    """[k] derivative of the cost."""
    damping: jax.Array
    """[] factor on the diagonal."""


@partial(jax.jit, static_argnames="iterations")
def identify(
    vehicle: CampaignVehicle,
    batch: RunBatch,
    counts: jax.Array,
    center: jax.Array,
    iterations: int = ITERATIONS,
) -> Fit:
    """Identify parameters by Levenberg and Marquardt's method.

    Args:
        vehicle: published vehicle about which the priors stand.
        batch: runs.
        counts: [run] how often each run counts: 1, 0, or as a bootstrap sample has it.
        center: [k] prior mean: 0, or sampled from the prior for a bootstrap sample.
        iterations: evaluations of the Jacobian.
    """

    def evaluate(vector: jax.Array) -> tuple[Fit, jax.Array]:
        cost, gradient, information = normal_equations(vector, vehicle, batch)
        total = jnp.sum(counts * cost) + 0.5 * jnp.sum((vector - center) ** 2)
        slope = jnp.sum(counts[:, None] * gradient, axis=0) + vector - center
        summed = jnp.sum(counts[:, None, None] * information, axis=0)
        return Fit(vector, total, summed), slope

    def iterate(before: _Iterate, _: None) -> tuple[_Iterate, jax.Array]:
        after = _Iterate(*evaluate(before.fit.vector - _damped_step(before)), before.damping)
        is_better = after.fit.cost < before.fit.cost
        kept: _Iterate = jax.tree.map(partial(jnp.where, is_better), after, before)
        damping = before.damping * jnp.where(is_better, DAMPING_DOWN, DAMPING_UP)
        return kept._replace(damping=damping), kept.fit.cost

    # The first pass evaluates at 0, as its slope is 0: `evaluate` before the loop would be traced
    # and compiled twice.
    k, dtype = center.shape[0], center.dtype
    nothing = Fit(jnp.zeros_like(center), jnp.asarray(jnp.inf, dtype), jnp.zeros((k, k), dtype))
    damping = jnp.asarray(FIRST_DAMPING / DAMPING_DOWN, dtype)
    begin = _Iterate(nothing, jnp.zeros_like(center), damping)
    return jax.lax.scan(iterate, begin, length=1 + iterations)[0].fit


def _damped_step(before: _Iterate) -> jax.Array:
    """Return the step [k] downhill, of normal equations with a prior and a larger diagonal."""
    k = before.slope.shape[0]
    matrix = before.fit.information + jnp.eye(k, dtype=before.slope.dtype)
    matrix = matrix + before.damping * jnp.diag(jnp.diag(matrix))
    step: jax.Array = jnp.linalg.solve(matrix, before.slope)
    return step


def sample_bootstrap(n_runs: int, n_samples: int, seed: int) -> BootstrapSample:
    """Return samples of n_runs runs each, with their prior means."""
    rng = np.random.default_rng(seed)
    chosen = rng.integers(n_runs, size=(n_samples, n_runs))
    counts = np.stack([np.bincount(row, minlength=n_runs) for row in chosen]).astype(float)
    return BootstrapSample(counts, rng.normal(size=(n_samples, len(LABELS))))


def identify_samples(
    vehicle: CampaignVehicle,
    batch: RunBatch,
    sample: BootstrapSample,
    iterations: int = ITERATIONS,
    progress: Callable[[int], object] = lambda _: None,
) -> np.ndarray:
    """Return parameters [sample, k] identified from each bootstrap sample.

    `SAMPLES_AT_ONCE` samples are identified side by side.

    Args:
        vehicle: published vehicle about which the priors stand.
        batch: runs.
        sample: runs and prior mean of each sample.
        iterations: evaluations of the Jacobian in each fit.
        progress: receives the number of samples after each part.
    """

    def identify_one(counts: jax.Array, center: jax.Array) -> jax.Array:
        fit: Fit = identify(vehicle, batch, counts, center, iterations)
        return fit.vector

    run = jax.jit(jax.vmap(identify_one))
    n = len(sample.counts)
    parts = []
    for first in range(0, n, SAMPLES_AT_ONCE):
        part = slice(first, first + SAMPLES_AT_ONCE)
        inputs = (jnp.asarray(x[part], float) for x in (sample.counts, sample.center))
        parts.append(np.asarray(run(*inputs)))
        progress(len(parts[-1]))
    vectors: np.ndarray = np.concatenate(parts)
    return vectors


def linearised_samples(
    fit: Fit, vehicle: CampaignVehicle, batch: RunBatch, sample: BootstrapSample
) -> np.ndarray:
    """Return parameters [sample, k] as `identify_samples`, by one Gauss-Newton step from a fit.

    The step uses gradient and information of each run at the fit of all runs.
    """
    equations = jax.jit(normal_equations)(fit.vector, vehicle, batch)
    gradient, information = (np.asarray(x, float) for x in equations[1:])
    vector: np.ndarray = np.asarray(fit.vector, float)
    of_sample = np.tensordot(sample.counts, information, 1) + np.eye(len(vector))
    right = sample.counts @ gradient + vector - sample.center
    steps: np.ndarray = np.linalg.solve(of_sample, right[:, :, None])[:, :, 0]
    vectors: np.ndarray = vector - steps
    return vectors


def unidentified_directions(information: np.ndarray, n: int) -> list[tuple[float, np.ndarray]]:
    """Return the n directions [k] in which the data add least to the prior, and their variances.

    The variance is that of the posterior; 1 means that the prior alone decides.
    """
    values, vectors = np.linalg.eigh(information)
    return [(1.0 / (1.0 + max(float(values[i]), 0.0)), vectors[:, i]) for i in range(n)]
