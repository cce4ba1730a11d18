"""Gains tuned by gradient track better, also on worlds that they were not tuned on."""

import pytest

from angler_experiments import tune_gains
from angler_mjx.errors import ConfigError

SCENARIO = """
schema_version = 1
name = "alone"

[time]
horizon_s = 20.0
record_hz = 1.0

[world]
preset = "angler2024"

[[fleet]]
vehicle = "bluerov2_heavy"

[[world.currents]]
type = "gauss_markov"
max_speed_mps = 0.3
"""


@pytest.mark.nightly(by="tuning/test_tuning.py")
def test_tuning_lowers_the_cost(tmp_path):
    path = tmp_path / "alone.toml"
    path.write_text(SCENARIO)
    result = tune_gains.tune(str(path), worlds=4, seconds=4.0, iterations=12)
    assert len(result.costs_m2) == 12
    assert result.costs_m2[-1] < 0.9 * result.costs_m2[0]
    before, after = result.unseen_m2
    assert after < before
    assert result.before["velocity.velocity_per_s"] == 4.0
    assert set(result.after) == set(result.before)
    assert all(gain > 0 and gain != result.before[name] for name, gain in result.after.items())


def test_nonsense_is_refused():
    with pytest.raises(ConfigError, match="iterations = 0"):
        tune_gains.tune(iterations=0)
