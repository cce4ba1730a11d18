"""One small scenario, compiled once, for all tests of runs."""

import pytest

from angler_mjx.scenario.scenario import load_scenario

SCENARIO = """
schema_version = 1
name = "small"
worlds = 5
seed = 3
tile = 2

[time]
horizon_s = 20.0
record_hz = 2.0

[world]
preset = "angler2024"
placement = "random"

[[fleet]]
vehicle = "bluerov2_heavy"
parameter_mix = { wu2018 = 1.0, von_benzon2022 = 2.0 }

[[fleet]]
vehicle = "bluerov2"

[world.obstacles.dynamic]
count = 3

[[world.currents]]
type = "gauss_markov"
max_speed_mps = 0.3
"""


@pytest.fixture(scope="session")
def scenario_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("scenario") / "small.toml"
    path.write_text(SCENARIO)
    return path


@pytest.fixture(scope="session")
def scenario(scenario_file):
    return load_scenario(scenario_file)
