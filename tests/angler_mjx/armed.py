"""A small run of robots with arms and of one without, flown once for all tests that read it."""

import re

import pytest

from angler_mjx.robot.vehicles import library
from angler_mjx.runs.rollout import rollout
from angler_mjx.scenario.scenario import load_scenario

ARM, LIMP, RIGID = 0, 1, 2
"""Robots: the shipped arm, one whose servos are off so that it falls, and one without.

The first one flies its arm into a ball that creeps, of which planners know nothing.
"""

SCENARIO = """
schema_version = 1
name = "armed"
worlds = 2
seed = 3
tile = 2
engine = "mjx"

[time]
horizon_s = 15.0
record_hz = 20.0

[store]
also = ["clearance"]

[world]
preset = "open"
placement = "given"
start_m = [[-1.0, -3.0, -5.0], [-1.0, 0.0, -5.0], [-1.0, 3.0, -5.0]]
goal_m = [[1.0, -3.0, -5.2], [0.0, 0.0, -5.0], [1.0, 3.0, -5.0]]

[[world.obstacles.explicit]]
type = "sphere"
position_m = [0.1, -3.11, -5.12]
radius_m = 0.1
motion = { type = "straight", velocity_mps = [-0.01, 0.0, 0.0] }

[[fleet]]
vehicle = "bluerov2_heavy_alpha5"

[[fleet]]
vehicle = "limp.toml"

[[fleet]]
vehicle = "bluerov2_heavy"
"""


def write_limp(path):
    """Write the shipped vehicle with its servos off and its upper arm raised; returns the path."""
    text = library.locate_vehicle("bluerov2_heavy_alpha5").read_text()
    text = text.replace('name = "bluerov2_heavy_alpha5"', 'name = "limp"')
    text = re.sub(r"^stiffness = .*", "stiffness = 0.0", text, flags=re.MULTILINE)
    text = re.sub(r"^damping = .*", "damping = 0.3", text, flags=re.MULTILINE)
    path.write_text(text.replace("home = 0.01", "home = 1.2"))
    return path


def write_scenario(folder, text=SCENARIO):
    """Write a scenario and its vehicle into a folder; returns its path."""
    write_limp(folder / "limp.toml")
    path = folder / "armed.toml"
    path.write_text(text)
    return path


@pytest.fixture(scope="session")
def armed_scenario(tmp_path_factory):
    return load_scenario(write_scenario(tmp_path_factory.mktemp("armed")))


@pytest.fixture(scope="session")
def armed_run(armed_scenario, tmp_path_factory):
    return rollout(armed_scenario, out=tmp_path_factory.mktemp("armed") / "run")
