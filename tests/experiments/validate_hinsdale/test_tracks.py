"""Judged part of runs: swaps masked, joints smooth, first second fitted."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from angler_experiments.validate_hinsdale.campaign import JointTrack, read_campaign
from angler_experiments.validate_hinsdale.tracks import (
    CUTOFF_HZ,
    STEP_S,
    build_track,
    mask_swaps,
    smooth_joints,
)

from . import recordings


def _read(folder, mocap, **options):
    recordings.write_run(folder, "traj001-0", mocap, **options)
    (run,) = read_campaign(folder)
    return run


@pytest.mark.parametrize("kind", ["attitude", "position"])
def test_a_marker_swap_is_masked_and_counted(tmp_path, kind):
    mocap = recordings.poses()
    if kind == "attitude":
        mocap[400:420, 4:] = Rotation.from_euler("ZYX", [-1.0, 0.0, 0.5]).as_quat()
    else:
        mocap[400:420, 1] += 0.5
    run = _read(tmp_path, mocap)
    keep = mask_swaps(run.mocap)
    assert list(np.flatnonzero(~keep)) == list(range(400, 420))
    track = build_track(run)
    assert (track.counts.masked, track.counts.swaps) == (20, 1)
    assert np.isnan(track.p_m[:, 0]).sum() >= 1
    assert np.nanmax(np.abs(track.angles_rad[:, 0] - 0.05)) < 1e-6


def test_a_swap_at_the_beginning_is_masked(tmp_path):
    mocap = recordings.poses()
    mocap[:150, 4:] = Rotation.from_euler("ZYX", [-1.0, 0.0, 0.5]).as_quat()
    assert not mask_swaps(_read(tmp_path, mocap).mocap)[:150].any()


def test_a_turning_vehicle_with_gaps_is_not_masked(tmp_path):
    mocap = recordings.poses()
    mocap[:, 4:] = Rotation.from_euler("Z", 0.5 * mocap[:, :1]).as_quat()
    mocap = np.delete(mocap, slice(300, 600), axis=0)
    assert mask_swaps(_read(tmp_path, mocap).mocap).all()


def test_small_steps_of_the_markers_stay_and_are_counted(tmp_path):
    mocap = recordings.poses()
    mocap[400:, 4:] = Rotation.from_euler("ZYX", [1.8, 0.03, 0.09]).as_quat()
    counts = build_track(_read(tmp_path, mocap)).counts
    assert (counts.masked, counts.small_steps) == (0, 1)


def test_the_judged_part_ends_below_the_surface(tmp_path):
    track = build_track(_read(tmp_path, recordings.poses(seconds=9.0, rise_mps=0.1)))
    assert track.t_s[0] == pytest.approx(2.0)
    assert np.nanmax(track.p_m[:, 2]) <= 1.2 + 0.05 * STEP_S
    assert track.counts.surface_cut_s == pytest.approx(1.0, abs=0.1)


def test_the_first_second_gives_the_state_at_its_end(tmp_path):
    mocap = recordings.poses()
    mocap[:, 4:] = Rotation.from_euler(
        "ZYX", np.stack([1.8 + 0.02 * mocap[:, 0], 0.03 + 0.01 * mocap[:, 0], 0.0 * mocap[:, 0]], 1)
    ).as_quat()
    mocap[120:140, 3] += 0.05  # a fifth of the first second is off
    track = build_track(_read(tmp_path, mocap))
    np.testing.assert_allclose(track.initial_angles_rad, [0.0, 0.05, 1.84], atol=1e-6)
    np.testing.assert_allclose(track.initial_rates_radps, [0.0, 0.01, 0.02], atol=1e-6)
    np.testing.assert_allclose(track.initial_p_m, [0.0, 0.0, 0.44], atol=2e-3)
    np.testing.assert_allclose(track.initial_v_mps, [0.0, 0.0, 0.02], atol=5e-3)


def test_other_markers_in_view_do_not_turn_the_vehicle(tmp_path):
    """Frames of the first second in two levels, 0.03 rad apart, of a vehicle that does not turn."""
    mocap = recordings.poses()
    level = np.random.default_rng(0).random(len(mocap)) < 0.4
    mocap[level, 4:] = Rotation.from_euler("ZYX", [1.8, 0.03, 0.08]).as_quat()
    track = build_track(_read(tmp_path, mocap))
    np.testing.assert_allclose(track.initial_rates_radps, 0.0, atol=1e-6)
    np.testing.assert_allclose(track.initial_v_mps, [0.0, 0.0, 0.02], atol=1e-6)


def _swing(frequency_hz):
    t = np.arange(0.0, 30.0, 0.02)
    swing = np.sin(2.0 * np.pi * frequency_hz * t)
    position = np.tile(swing[:, None], (1, 4))
    track = JointTrack(
        t_s=t, position_rad=position, velocity_radps=0.0 * position, blank_rows=0, repeated_rows=0
    )
    at = np.arange(5.0, 25.0, 0.013)
    return at, smooth_joints(track, at)


def test_slow_joints_keep_their_acceleration():
    w = 2.0 * np.pi * 0.2
    at, (position, velocity, acceleration) = _swing(0.2)
    np.testing.assert_allclose(position[:, 0], np.sin(w * at), atol=2e-3)
    np.testing.assert_allclose(velocity[:, 0], w * np.cos(w * at), atol=3e-3)
    np.testing.assert_allclose(acceleration[:, 0], -(w**2) * np.sin(w * at), atol=5e-3)


def test_the_cutoff_halves_an_oscillation():
    at, (position, _, _) = _swing(CUTOFF_HZ)
    reference = np.sin(2.0 * np.pi * CUTOFF_HZ * at)
    gain = position[:, 0] @ reference / (reference @ reference)
    assert gain == pytest.approx(0.5, abs=0.01)


def test_the_campaign_has_few_swaps():
    """Found are 68 frames in 5 swaps of 40 runs, and every run has a judged part."""
    runs = [run for run in read_campaign(recordings.real_folder()) if run.copy_of is None]
    tracks = [build_track(run) for run in runs]
    assert len(tracks) == 40
    assert 20 <= sum(track.counts.masked for track in tracks) <= 150
    assert all(len(track.t_s) * STEP_S > 8.0 for track in tracks)
    assert all(np.isfinite(track.initial_v_mps).all() for track in tracks)
