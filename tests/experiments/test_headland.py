"""The scenarios that lie beside the headland's file."""

import shutil
from pathlib import Path

import numpy as np
import pytest

import angler_experiments.ocean
from angler_experiments.ocean import headland
from angler_mjx.scenario.scenario import load_scenario
from angler_mjx.world.generate import generate_batch


@pytest.mark.parametrize("name", ["tidal_headland", "headland_survey"])
def test_scenarios_find_room_off_the_headland(name, tmp_path):
    headland.write_dataset(tmp_path / "headland.nc")
    beside = Path(angler_experiments.ocean.__file__).parent / f"{name}.toml"
    scenario = load_scenario(Path(shutil.copy(beside, tmp_path)))
    worlds = generate_batch(scenario.world, np.full(2, 0.4), 1, 0, 4)
    assert np.asarray(worlds.valid).all()
    if name == "headland_survey":
        land = np.asarray(worlds.grid.occupied).all(axis=3)
        assert (land.mean(axis=(1, 2)) > 0.1).all()
        # All lie at one place, land is south of the sea, and the straight coast is narrower.
        assert (land == land[0]).all()
        width = land[0].sum(axis=1)
        assert land[0][:, : width.min()].all()
        assert width[len(width) // 2] > width[0] + 3
