"""The audit of planned teams, against places sampled closely in time."""

import numpy as np

from angler_experiments.benchmarks.plan_separation import min_gap_m


def test_least_gap_is_that_of_close_sampling():
    rng = np.random.default_rng(3)
    for team in (2, 3, 5):
        times = [np.r_[0.0, np.sort(rng.uniform(1.0, 20.0, 6))] for _ in range(team)]
        positions = [rng.uniform(-10.0, 10.0, (7, 3)) for _ in range(team)]
        radius = rng.uniform(0.2, 0.5, team)
        t = np.linspace(0.0, 25.0, 20001)
        at = np.stack(
            [
                np.stack([np.interp(t, one, p[:, k]) for k in range(3)], axis=1)
                for one, p in zip(times, positions, strict=True)
            ]
        )
        gaps = [
            np.linalg.norm(at[i] - at[j], axis=1).min() - radius[i] - radius[j]
            for i in range(team)
            for j in range(i)
        ]
        # Sampling misses what two robots move in half a sample: 0.6 ms at 40 m/s each.
        assert min(gaps) - 0.05 < min_gap_m(times, positions, radius) <= min(gaps) + 1e-9


def test_robots_that_stand_keep_their_distance():
    still = [np.zeros(1), np.zeros(1)]
    positions = [np.array([[0.0, 0.0, 0.0]]), np.array([[0.0, 3.0, 4.0]])]
    assert min_gap_m(still, positions, np.array([1.0, 2.0])) == 2.0
