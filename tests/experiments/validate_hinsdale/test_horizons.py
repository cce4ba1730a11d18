"""Errors after a few steps: windows of recordings, and predictions of them."""

import numpy as np

from angler_experiments.validate_hinsdale import horizons
from angler_experiments.validate_hinsdale.campaign import read_campaign
from angler_experiments.validate_hinsdale.tracks import build_track
from angler_experiments.validate_hinsdale.vehicle import SOURCE_SET, build_campaign_vehicle

from . import recordings


def _windows(folder, mocap):
    folder.mkdir(exist_ok=True)
    recordings.write_run(folder, "traj001-0", mocap)
    runs = read_campaign(folder)
    return horizons.cut_windows(runs, [build_track(run) for run in runs])


def test_windows_hold_the_state_of_a_steady_rise(tmp_path):
    windows = _windows(tmp_path, recordings.poses(rise_mps=0.02))
    assert windows.recorded.shape[1:] == (4, 12)
    assert windows.joints.position.shape[1:] == (201, 5)
    still = windows.recorded[:, :, [3, 4, 8, 9, 10, 11]]
    np.testing.assert_allclose(still[..., :3], np.array([0.05, 0.03, 0.02]) + 0 * still[..., :3],
                               atol=1e-4)  # fmt: skip
    np.testing.assert_allclose(still[..., 3:], 0.0, atol=1e-4)


def test_constant_velocity_predicts_a_steady_rise(tmp_path):
    windows = _windows(tmp_path, recordings.poses(rise_mps=0.02))
    errors = horizons.score_windows(windows, horizons.predict_drift(windows))
    assert max(errors["states"]) < 1e-4
    # An error of one component of twelve.
    predicted = windows.recorded[:, 1:].copy()
    predicted[..., 2] += 0.12
    errors = horizons.score_windows(windows, predicted)
    np.testing.assert_allclose(errors["states"], 0.12 / np.sqrt(12.0))
    np.testing.assert_allclose(errors["position_m"], 0.12 / np.sqrt(3.0))
    np.testing.assert_allclose(errors["rate_radps"], 0.0)


def test_windows_with_changed_markers_are_left_out(tmp_path):
    mocap = recordings.poses(seconds=12.0)
    count = len(_windows(tmp_path / "whole", mocap).recorded)
    tilted = recordings.poses(seconds=12.0, roll=0.08)
    late = mocap[:, 0] > 7.0
    changed = np.where(late[:, None], tilted, mocap)
    assert 0 < len(_windows(tmp_path / "step", changed).recorded) < count


def test_a_vehicle_begins_at_the_recorded_state(tmp_path):
    windows = _windows(tmp_path, recordings.poses())
    predicted = horizons.predict_windows(build_campaign_vehicle(SOURCE_SET), windows)
    assert predicted.shape == (len(windows.recorded), 3, 12)
    np.testing.assert_allclose(predicted[:, 0, :6], windows.recorded[:, 1, :6], atol=2e-4)
    errors = horizons.score_windows(windows, predicted)
    assert errors["position_m"] == sorted(errors["position_m"])
    assert errors["states"][0] == min(errors["states"])
