"""A fleet of a parameter set with its uncertainty flies; each robot is one of the variants."""

import json

import numpy as np
import pytest

from angler_mjx.runs.rollout import rollout
from angler_mjx.scenario.scenario import load_scenario

SCENARIO = """
schema_version = 1
name = "brief_drift"
worlds = 4
seed = 3
tile = 4
engine = "fused"
kernels = "xla"

[time]
horizon_s = 40.0
record_hz = 0.5

[world]
preset = "open"
placement = "given"
start_m = [[-6.0, -6.0, -10.0], [-6.0, 6.0, -10.0]]
goal_m = [[6.0, -6.0, -10.0], [6.0, 6.0, -10.0]]

[randomise]
uncertainty = true
variants = 8

[[fleet]]
vehicle = "bluerov2_heavy"
parameter_set = "hinsdale2023_identified"
count = 2
"""


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("drift")
    file = folder / "drift.toml"
    file.write_text(SCENARIO)
    return rollout(load_scenario(file), out=folder / "run", devices=1)


def test_robots_fly_as_variants_of_their_own(run):
    rows = run.episodes.to_pylist()
    lengths: dict[int, list[float]] = {}
    for row in rows:
        lengths.setdefault(row["variant"], []).append(row["path_length_m"])
    assert len(lengths) > 2
    assert min(map(min, lengths.values())) > 5.0
    # All begin alike in still water: robots of one variant fly alike, of others they do not.
    for values in lengths.values():
        np.testing.assert_allclose(values, values[0], rtol=1e-4)
    assert np.ptp([values[0] for values in lengths.values()]) > 1e-3


def test_the_folder_says_what_was_sampled(run):
    rows = json.loads((run.path / "variants.json").read_text())["variants"]
    assert len({tuple(row["drawn"]["deviations"]) for row in rows}) == 8
