"""Runs whose controllers are not told the truth: what is refused and recorded, and how they do."""

import jax
import numpy as np
import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.runs.rollout import rollout
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.scenario.scenario import Scenario, load_scenario
from angler_mjx.sim.state import Outcome

SCENARIO = """
schema_version = 1
name = "told"
engine = "fused"
kernels = "xla"
worlds = 8
seed = 11
tile = 8
goal_tolerance_m = 0.5

[time]
horizon_s = 60.0
record_hz = 2.0

[world]
preset = "open"
placement = "random"

[[fleet]]
vehicle = "bluerov2_heavy"
parameter_set = "wu2018"
{first}

[[fleet]]
vehicle = "bluerov2_heavy"
parameter_set = "wu2018"
{second}

[[world.currents]]
type = "gauss_markov"
max_speed_mps = 0.2
"""
EKF = 'estimate = "ekf"'
DROPOUTS = f"{EKF}\n[fleet.sensors.dvl]\ndropout = 0.5"


def load(folder, first="", second=""):
    path = folder / "told.toml"
    path.write_text(SCENARIO.format(first=first, second=second))
    return load_scenario(path)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Eight worlds: all instruments as they come, and a DVL that loses every other reading."""
    folder = tmp_path_factory.mktemp("told")
    scenario = load(folder, EKF, DROPOUTS)
    done = rollout(scenario, out=folder / "run", devices=1)
    return scenario, done


@pytest.mark.nightly(by="control/test_navigation.py and sim/test_senses.py")
def test_robots_arrive_by_their_own_estimate(run):
    _, done = run
    rows = done.episodes.to_pylist()
    assert {row["outcome"] for row in rows if row["planned"]} == {"reached"}
    # The planner has no way for one of them, whatever it is told.
    assert sum(row["planned"] for row in rows) == 15


@pytest.mark.nightly(by="control/test_navigation.py and sim/test_senses.py")
def test_the_estimate_is_as_wrong_as_it_says(run):
    _, done = run
    arrays, told = done.trajectories, done.trajectories["estimate"]
    for truth, believed, std in (("p_m", "p_m", "position_std_m"),):
        off = told[believed][...] - arrays[truth][...]
        there = np.isfinite(off[..., 0])
        square = np.square(off / told[std][...])[there]
        # One in 1e5 is beyond 4.5; there are some 4,000 numbers, and they hang together.
        assert square.max() < 4.5**2
        # Three axes of 16 robots, each off by nearly the same all the time: chi-square of 48
        # degrees of freedom lies between these in all but one of 10,000.
        assert 0.35 < square.mean() < 2.0
    # Both do better than they began, 0.1 m along each axis, but for 0.5 degrees of 10 m of way.
    error = np.linalg.norm(told["p_m"][...] - arrays["p_m"][...], axis=-1)
    assert np.nanmax(error) < 0.6


@pytest.mark.nightly(by="control/test_navigation.py and sim/test_senses.py")
def test_a_dvl_that_loses_readings_costs_little(run):
    _, done = run
    std = done.trajectories["estimate/velocity_std_mps"][:, 20]
    # Half the readings: noise goes by the root of it.
    ratio = std[:, 1].mean() / std[:, 0].mean()
    assert 1.0 < ratio < 1.6


@pytest.mark.nightly(by="control/test_navigation.py and sim/test_senses.py")
def test_what_is_recorded(run):
    scenario, done = run
    told = done.trajectories["estimate"]
    widths = {name: array.shape[3] for name, array in told.arrays()}
    assert widths == {
        "p_m": 3,
        "q": 4,
        "nu": 6,
        "position_std_m": 3,
        "velocity_std_mps": 3,
        "attitude_std_rad": 3,
    }
    assert told["p_m"].shape == (8, 120, 2, 3)
    assert told["p_m"].attrs["unit"] == "m"
    np.testing.assert_allclose(np.linalg.norm(told["q"][:, 0], axis=-1), 1.0, rtol=1e-6)
    assert Scenario.model_validate(scenario.model_dump(mode="json")) == scenario


@pytest.mark.nightly(by="test_senses.py: test_without_noise_the_filter_is_near_the_truth")
def test_noise_that_is_off_gives_the_same_bytes_as_the_truth(tmp_path):
    seen = []
    for told in ("", 'estimate = "noisy"\n[fleet.sensors]\nnoise = false'):
        simulator = Simulator(load(tmp_path, told, told))
        worlds = simulator.worlds()
        assert worlds.sensing_key is None
        state = simulator.reset(worlds)
        assert state.senses == ()
        seen.append(jax.device_get(simulator.segment(worlds, state)))
    jax.tree.map(np.testing.assert_array_equal, *seen)
    assert seen[0][1].belief is None
    assert np.any(seen[0][0].tally.outcome == Outcome.RUNNING)


@pytest.mark.parametrize(
    ("told", "message"),
    [
        ("[fleet.sensors.dvl]\nfitted = false", "not used with estimate"),
        ('estimate = "kalman"', "estimate"),
        (f"{EKF}\n[fleet.sensors.dvl]\nmin_altitude_m = 60.0", "min_altitude_m = 60.0"),
        (f"{EKF}\n[fleet.sensors.usbl]\nfitted = true\nlatency_s = 3.0", "latency_s = 3.0"),
        (f"{EKF}\n[fleet.sensors.sonar]\nfitted = true", "sonar"),
    ],
)
def test_bad_instruments_are_refused(tmp_path, told, message):
    with pytest.raises(ConfigError, match=message):
        load(tmp_path, "", told)
