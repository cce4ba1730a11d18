"""One session of two Heavies in open water, compiled once."""

import pytest

from angler_mjx.runs.session.batch_session import BatchSession
from angler_mjx.scenario.scenario import load_scenario

SCENE = """
schema_version = 1
name = "served"
seed = 3

[time]
horizon_s = 60.0

[world]
preset = "open"
placement = "given"
start_m = [[-3.0, -2.0, -4.0], [-3.0, 2.0, -5.0]]
goal_m = [[9.0, -2.0, -4.0], [9.0, 2.0, -5.0]]

[[world.currents]]
type = "uniform"
velocity_mps = [0.05, -0.1, 0.0]

[[fleet]]
vehicle = "bluerov2_heavy"
parameter_set = "wu2018"
count = 2
"""


@pytest.fixture(scope="session")
def scene_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("served") / "served.toml"
    path.write_text(SCENE)
    return path


@pytest.fixture(scope="session")
def scene(scene_file):
    return load_scenario(scene_file)


@pytest.fixture(scope="session")
def session(scene):
    return BatchSession(scene)
