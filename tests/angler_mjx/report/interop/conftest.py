"""The small run that the pictures are tested with, with velocities and thruster signals added."""

import numpy as np
import pytest
import zarr

from ..conftest import make_motion, make_run, make_scene


@pytest.fixture(scope="session")
def run(tmp_path_factory):
    """A run folder of two worlds; its third robot diverges after 20 s in world 1."""
    made = make_run(tmp_path_factory.mktemp("interop") / "run", [make_scene(0), make_scene(1)], 2)
    rng = np.random.default_rng(5)
    group = zarr.open_group(made.path / "trajectories.zarr", mode="r+")
    group["nu"][:] = rng.normal(size=group["nu"].shape)
    group["pwm_us"][:] = rng.integers(1100, 1901, group["pwm_us"].shape)
    for name in ("p_m", "q", "nu"):
        group[name][1, 100:, 2] = np.nan
    return made


@pytest.fixture(scope="session")
def scene_maker():
    """Makes the scene of a seed again; world i of the run has seed i."""
    return make_scene


@pytest.fixture(scope="session")
def jointed(tmp_path_factory):
    """A run whose plans have headings and velocities, and these; nobody moves in it."""
    motion = make_motion(1)
    path = tmp_path_factory.mktemp("interop") / "jointed"
    made = make_run(path, [make_scene(0)], 1, motion)
    group = zarr.open_group(made.path / "trajectories.zarr", mode="r+")
    group["p_m"][:] = np.nan
    return made, motion
