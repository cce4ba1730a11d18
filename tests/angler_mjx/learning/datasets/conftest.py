"""One small dataset, made once by the command itself, for all tests of datasets."""

import shutil

import pytest

from angler_mjx.cli import main

from ...sharing import alone, shared_folder

FILE = """
schema_version = 1
name = "small"
description = "For tests."
scenario = "scenario.toml"
seed = 4

[split]
train = 0.5
val = 0.25
test = 0.25

[[scene]]
name = "here"
weight = 2.0

[[scene]]
name = "there"
teams = [1]
shifted = true

[[expert]]
name = "grid"
"""

SCENARIO = """
schema_version = 1
name = "small"
engine = "fused"
tile = 2

[time]
horizon_s = 4.0
record_hz = 5.0

[store]
position_mm = 1.0
velocity_mmps = 1.0

[world]
preset = "angler2024"
placement = "random"

[[fleet]]
vehicle = "bluerov2_heavy"
count = 2

[world.obstacles.dynamic]
count = 2

[randomise]
variants = 3
mass = [0.97, 1.03]
thrust = [0.9, 1.0]
"""


@pytest.fixture(scope="session")
def file(tmp_path_factory):
    folder = shared_folder(tmp_path_factory, "dataset")
    with alone(folder):
        for name, text in (("scenario.toml", SCENARIO), ("small.toml", FILE)):
            if not (folder / name).exists():
                (folder / name).write_text(text)
    return folder / "small.toml"


@pytest.fixture(scope="session")
def made(file):
    """Six worlds in two parts; not to be changed."""
    out = file.parent / "made"
    with alone(file.parent):
        if not out.exists():
            main.main(["dataset", "make", str(file), "--episodes", "6", "--out", str(out)])
    return out


@pytest.fixture
def copy(made, tmp_path):
    """One that may be damaged."""
    return shutil.copytree(made, tmp_path / "copy")
