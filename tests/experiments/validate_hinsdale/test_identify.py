"""Identification finds what moved a simulated vehicle; bands hold what they say."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_experiments.validate_hinsdale import bands, identify
from angler_experiments.validate_hinsdale.batch import build_batch, simulate_batch
from angler_experiments.validate_hinsdale.campaign import read_campaign
from angler_experiments.validate_hinsdale.parameters import LABELS, apply_parameters
from angler_experiments.validate_hinsdale.tracks import STEP_S, build_track
from angler_experiments.validate_hinsdale.vehicle import SOURCE_SET, build_campaign_vehicle

from . import recordings


def _runs(folder, seconds=12.0):
    """Return tracks of two runs in which the upper arm swings up by 1.5 rad, yawed apart."""
    for i, yaw in enumerate((0.5, 2.0)):
        mocap = recordings.poses(seconds=seconds, roll=0.06, pitch=0.03, yaw=yaw)
        t = mocap[::2, :1]
        arm = np.tile(recordings.FOLDED, (len(t), 1))
        arm[:, 3] += 0.75 * (1.0 - np.cos(np.pi * np.clip((t[:, 0] - 2.5) / 5.0, 0.0, 1.0)))
        joints = np.hstack([t, arm, np.zeros((len(t), 5))])
        recordings.write_run(folder, f"traj00{i}-0", mocap, joints)
    return [build_track(run) for run in read_campaign(folder)]


@pytest.mark.nightly(by="test_samples_of_the_posterior_spread_as_the_prior_without_data")
def test_parameters_of_a_simulated_vehicle_are_found(tmp_path):
    batch = build_batch(_runs(tmp_path))
    vehicle = build_campaign_vehicle(SOURCE_SET)
    truth = np.zeros(len(LABELS))
    changed = {"center_of_buoyancy x": 0.4, "center_of_buoyancy z": 0.3, "marker_yaw yaw": -0.8}
    for label, value in changed.items():
        truth[LABELS.index(label)] = value
    motion = simulate_batch(apply_parameters(vehicle, jnp.asarray(truth)), batch)
    recorded = batch.__class__(
        **{**vars(batch), "angles_rad": motion.angles_rad, "p_m": motion.p_m}
    )
    zero = jnp.zeros(len(LABELS))
    fit = identify.identify(vehicle, recorded, jnp.ones(2), zero, 24)
    # The truth leaves no residual and costs its prior, of unit spread, alone: the mode of the
    # posterior costs no more.
    assert float(fit.cost) <= 0.5 * np.sum(truth**2)
    # Two runs with one motion of the arm leave the yaw of markers to the prior by half.
    for label in ("center_of_buoyancy x", "center_of_buoyancy z"):
        assert float(fit.vector[LABELS.index(label)]) == pytest.approx(changed[label], abs=0.1)
    assert float(fit.vector[LABELS.index("marker_yaw yaw")]) < -0.2


def _curved(x):
    """Return residuals [2] and Jacobian [2, 2] of Rosenbrock's valley, as a run."""
    return (
        np.array([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]]),
        np.array([[-20.0 * x[0], 10.0], [-1.0, 0.0]]),
    )


@pytest.mark.parametrize("iterations", [0, 1, 2, 6, 12])
def test_identification_is_the_method_of_levenberg_and_marquardt(monkeypatch, iterations):
    """By the book in float64, of one run that counts three times, with a prior about (3, 0)."""
    center, counts = np.array([3.0, 0.0]), 3.0

    def equations(vector, *_):
        def residuals(x):
            return jnp.stack([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]])

        residual, slopes = residuals(vector), jax.jacobian(residuals)(vector)
        gradient, information = slopes.T @ residual, slopes.T @ slopes
        return 0.5 * jnp.sum(residual**2)[None], gradient[None], information[None]

    def cost(x):
        return 0.5 * counts * np.sum(_curved(x)[0] ** 2) + 0.5 * np.sum((x - center) ** 2)

    x, damping, n_rejected = np.zeros(2), 0.01, 0
    for _ in range(iterations):
        residual, slopes = _curved(x)
        matrix = counts * slopes.T @ slopes + np.eye(2)
        matrix += damping * np.diag(np.diag(matrix))
        downhill = counts * slopes.T @ residual + x - center
        tried = x - np.linalg.solve(matrix, downhill)
        is_better = cost(tried) < cost(x)
        x, damping = (tried, 0.2 * damping) if is_better else (x, 5.0 * damping)
        n_rejected += not is_better
    assert n_rejected > 0 or iterations < 6
    monkeypatch.setattr(identify, "normal_equations", equations)
    fit = identify.identify.__wrapped__(
        None, None, jnp.array([counts]), jnp.asarray(center), iterations
    )
    np.testing.assert_allclose(fit.vector, x, rtol=1e-4, atol=1e-6)
    assert float(fit.cost) == pytest.approx(cost(x), rel=1e-4)
    slopes = _curved(x)[1]
    np.testing.assert_allclose(fit.information, counts * slopes.T @ slopes, rtol=1e-4)


def test_samples_are_fitted_in_parts_that_are_reported(monkeypatch):
    """Each part of two is reported when it is done, and samples keep their order."""
    sample = identify.BootstrapSample(np.eye(5), np.arange(15.0).reshape(5, 3))

    def fit_one(vehicle, batch, counts, center, iterations):
        return identify.Fit(center + jnp.argmax(counts), jnp.zeros(()), jnp.zeros((3, 3)))

    monkeypatch.setattr(identify, "identify", fit_one)
    monkeypatch.setattr(identify, "SAMPLES_AT_ONCE", 2)
    amounts = []
    vectors = identify.identify_samples(None, None, sample, 12, amounts.append)
    assert amounts == [2, 2, 1]
    np.testing.assert_array_equal(vectors, sample.center + np.arange(5.0)[:, None])


def test_samples_of_the_posterior_spread_as_the_prior_without_data(monkeypatch):
    """Of three parameters the data determine the first by far, the second as well as the prior."""
    information = np.diag([1e4, 1.0, 0.0])
    gradient = np.zeros((4, 3))
    equations = (np.zeros(4), gradient, np.tile(information / 4.0, (4, 1, 1)))
    monkeypatch.setattr(identify, "normal_equations", lambda *_: equations)
    monkeypatch.setattr(identify.jax, "jit", lambda function: function)
    vector = jnp.array([0.5, 0.0, 0.0])
    fit = identify.Fit(vector, jnp.zeros(()), jnp.asarray(information))
    rng = np.random.default_rng(0)
    sample = identify.BootstrapSample(np.ones((4000, 4)), rng.normal(size=(4000, 3)))
    vectors = identify.linearised_samples(fit, None, None, sample)
    np.testing.assert_allclose(vectors.std(axis=0), [1e-4, 0.5, 1.0], rtol=0.05)


def test_bootstrap_samples_have_as_many_runs():
    sample = identify.sample_bootstrap(7, 50, seed=1)
    assert np.all(sample.counts.sum(axis=1) == 7)
    assert sample.center.shape == (50, len(LABELS))


def test_directions_without_information_come_first():
    (variance, direction), (second, _) = identify.unidentified_directions(np.diag([9.0, 0.0]), 2)
    assert (variance, second) == (1.0, pytest.approx(0.1))
    np.testing.assert_allclose(np.abs(direction), [0.0, 1.0])


def test_bands_hold_what_they_say(tmp_path):
    """Recordings and fleet are of one distribution: the bands hold their levels of them."""
    track = _runs(tmp_path)[0]
    n = len(track.t_s)
    rng = np.random.default_rng(0)
    recorded = rng.normal(size=(n, 3))
    track.angles_rad[:, :2], track.p_m[:, 2:] = recorded[:, :2], recorded[:, 2:]
    paths = rng.normal(size=(400, n + 10, 3))
    for level in bands.LEVELS:
        held = bands.coverage([track], [paths], level)
        for fraction in held.values():
            assert fraction == pytest.approx(level, abs=4.0 * np.sqrt(0.25 / n))


def test_out_of_bag_errors_use_samples_without_the_run(tmp_path):
    tracks = _runs(tmp_path)
    n = len(tracks[0].t_s)
    simulated = np.zeros((2, 2, n, 3))
    simulated[0] += 1.0
    counts = np.array([[2.0, 0.0], [0.0, 2.0]])
    errors = bands.out_of_bag_errors(tracks, simulated, counts)
    recorded = bands.recorded_coordinates(tracks[1], n)
    assert n * STEP_S > 5.0
    np.testing.assert_allclose(errors[1], recorded - 1.0)
    np.testing.assert_allclose(errors[0], bands.recorded_coordinates(tracks[0], n))
