"""A run in the current of a file: what its folder keeps, and files that were edited since."""

import json

import numpy as np
import pytest

from angler_experiments.ocean import headland
from angler_mjx.errors import ConfigError
from angler_mjx.runs.rollout import rollout
from angler_mjx.runs.simulator import devices
from angler_mjx.runs.storage import environments, folder, input_copies
from angler_mjx.scenario.scenario import load_scenario

SCENARIO = """
schema_version = 1
name = "tide"
engine = "fused"
kernels = "xla"
worlds = 3
tile = 2
seed = 5

[time]
horizon_s = 2.0
record_hz = 2.0

[world]
preset = "open"
placement = "random"

[[fleet]]
vehicle = "bluerov2_heavy"

[[world.currents]]
type = "grid"
file = "sea/headland.nc"
"""


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    there = tmp_path_factory.mktemp("ocean_run")
    (there / "sea").mkdir()
    headland.write_dataset(there / "sea" / "headland.nc")
    (there / "tide.toml").write_text(SCENARIO)
    return there


@pytest.fixture(scope="module")
def run(place):
    rollout(load_scenario(place / "tide.toml"), out=place / "run")
    return folder.Run(place / "run")


def test_robots_feel_the_water_of_the_file(run):
    current = np.asarray(run.trajectories["current_mps"])[:, 0, 0]
    group = run.trajectories["environment"]
    for world in range(3):
        environment = environments.read_environments(group, world)
        (one,) = environment.current
        v = np.asarray(one.flow(environment.start_m[0], np.float32(0.0))[0])
        np.testing.assert_allclose(current[world], v, atol=1e-6)
    assert np.ptp(current, axis=0)[:2].max() > 0.02, "each world has a place of its own"


def test_the_folder_keeps_the_file_and_is_read_without_it(run, place):
    (kept,) = [one for one in input_copies.read_inputs(run.path) if one.role == "ocean"]
    copy = run.path / "inputs" / kept.copy_path
    assert copy.read_bytes() == (place / "sea" / "headland.nc").read_bytes()
    assert kept.source == str(place / "sea" / "headland.nc")
    before = environments.read_environments(run.trajectories["environment"], 1).current[0].field
    source = place / "sea" / "headland.nc"
    moved = source.rename(place / "sea" / "elsewhere.nc")
    try:
        again = folder.Run(run.path)
        assert again.scenario.world.currents[0].file == str(copy.resolve())
        assert (
            environments.read_environments(again.trajectories["environment"], 1).current[0].field
            == before
        )
        input_copies.require_unchanged(run.path, flag="--resume run")
    finally:
        moved.rename(source)


def test_an_edited_file_is_not_gone_on_with(run, place):
    source = place / "sea" / "headland.nc"
    before = source.read_bytes()
    headland.write_dataset(source, 12)
    try:
        with pytest.raises(ConfigError, match=r"headland\.nc was edited since the run began"):
            input_copies.require_unchanged(run.path, flag="--resume run")
        # What was flown is still shown as it was.
        field = environments.read_environments(run.trajectories["environment"], 0).current[0].field
        assert field.shape[:2] == (24, 24)
    finally:
        source.write_bytes(before)
    input_copies.require_unchanged(run.path, flag="--resume run")


def test_the_digest_of_a_scenario_is_that_of_the_numbers(place):
    one = load_scenario(place / "tide.toml")
    (place / "copy.nc").write_bytes((place / "sea" / "headland.nc").read_bytes())
    current = json.loads(one.world.model_dump_json())["currents"][0]

    def of(**keys):
        world = {"preset": "open", "placement": "random", "currents": [{**current, **keys}]}
        return load_scenario(place / "tide.toml", world=world).digest()

    assert of() == one.digest()
    assert of(file=str(place / "copy.nc")) == one.digest()
    headland.write_dataset(place / "other.nc", 12)
    assert of(file=str(place / "other.nc")) != one.digest()


def test_a_horizon_beyond_the_file_is_refused(place):
    scale = 'file = "sea/headland.nc"\nscale = { time = 1e-5 }'
    (place / "long.toml").write_text(SCENARIO.replace('file = "sea/headland.nc"', scale))
    with pytest.raises(ConfigError, match=r"world\.currents\[0\]\.file: covers 2024-06-01.*2 s"):
        load_scenario(place / "long.toml")


def test_fields_that_a_device_cannot_hold_are_refused(place, monkeypatch):
    held = load_scenario(place / "tide.toml").world.held_bytes
    assert held == 4 * (24 * 24 * 8 * 26 * 2)  # u and v at all knots, float32
    monkeypatch.setattr(devices, "limit_bytes", lambda device: 12 * held - 4)
    with pytest.raises(
        ConfigError, match=r"the fields of files take 958 kB.*a device has 11\.5 MB"
    ):
        devices.require_memory(held)
    monkeypatch.setattr(devices, "limit_bytes", lambda device: 12 * held)
    devices.require_memory(held)
