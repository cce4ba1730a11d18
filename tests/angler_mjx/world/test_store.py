"""Environments on disk: what is written is read, and nothing half-written is left."""

import errno

import jax
import numpy as np
import pytest
import zarr

from angler_mjx.cli import env
from angler_mjx.errors import ConfigError, RunError
from angler_mjx.runs.storage import environments as store
from angler_mjx.world.generate import generate_batch

from .recipe import COUNT, RADIUS, RECIPE, SEED

STORED = 3000


def make(path, count, **how):
    return store.generate_file(path, RECIPE, RADIUS, SEED, count, tile=COUNT, **how)


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    """Three thousand worlds in tiles of 2,001: the last tile is not full."""
    path = tmp_path_factory.mktemp("store") / "envs.zarr"
    invalid = make(path, STORED)
    assert 0 < invalid == np.sum(~store.open_environments(path)["valid"][:])
    return path


def test_what_is_read_is_what_was_generated(file):
    made = generate_batch(RECIPE, RADIUS, SEED, 1500, COUNT)
    group = store.open_environments(file)
    batch = store.read_environments(group, slice(1500, STORED))
    assert jax.tree.structure(batch) == jax.tree.structure(made)
    jax.tree.map(lambda a, b: np.testing.assert_array_equal(a, b[:1500]), batch, made)
    one = store.read_environments(group, 2400)
    jax.tree.map(lambda a, b: np.testing.assert_array_equal(a, b[900]), one, made)


def test_arrays_say_their_units(file):
    group = store.open_environments(file)
    assert group["valid"].shape == (STORED,)
    units = {
        "start_m": "m",
        "start_yaw_rad": "rad",
        "current/2/circulation_m2ps": "m^2/s",
        "obstacles/inertia_kgm2": "kg m^2",
        "obstacles/p0": "m",
        "grid/occupied": "1",
        "path_ratio": "1",
    }
    for name, unit in units.items():
        assert group[name].attrs["unit"] == unit, name


def test_an_existing_file_is_left_alone(file):
    before = sorted(file.rglob("*"))
    with pytest.raises(ConfigError, match="exists"):
        make(file, STORED)
    assert sorted(file.rglob("*")) == before


def test_a_full_disk_leaves_nothing(tmp_path, monkeypatch):
    def full(group, first, environment):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(store, "write_batch", full)
    with pytest.raises(RunError, match="No space left"):
        make(tmp_path / "envs.zarr", COUNT)
    assert list(tmp_path.iterdir()) == []


def test_interruption_leaves_nothing(tmp_path):
    def interrupt(done):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        make(tmp_path / "envs.zarr", 2 * COUNT, advance=interrupt)
    assert list(tmp_path.iterdir()) == []


def test_other_files_are_refused(tmp_path):
    zarr.open_group(tmp_path / "other.zarr", mode="w")
    for name in ("other.zarr", "nothing.zarr"):
        with pytest.raises(ConfigError, match=name):
            store.open_environments(tmp_path / name)


def test_a_picture_of_a_stored_world(file, tmp_path):
    picture = tmp_path / "env.png"
    env.show_environment(file, index=2, out=picture)
    assert picture.read_bytes().startswith(b"\x89PNG")
    with pytest.raises(ConfigError, match="0 to 2999"):
        env.show_environment(file, index=STORED, out=picture)


def test_the_command_makes_a_file_of_the_nine_boxes_of_the_paper(tmp_path, capsys):
    path = tmp_path / "envs.zarr"
    env.make_environments(path, preset="angler_nine_boxes", count=2, robots=2, tile=2)
    assert capsys.readouterr().out.strip().endswith(str(path))
    world = store.read_environments(store.open_environments(path), 1)
    assert world.goal_m.shape == (2, 3)
    assert world.valid
    assert world.floor_z_m == -10.0
    assert not world.grid.occupied.any()
    boxes = world.obstacles
    drifting = boxes.motion == 1
    assert drifting.sum() == 6
    assert sorted(boxes.mass_kg[drifting]) == [965, 965, 968, 969, 970, 971]
    # True inertia of a cube, m a^2 / 6; the original has 0.16666 kg m^2. float32 rounding.
    np.testing.assert_allclose(
        boxes.inertia_kgm2[drifting], boxes.mass_kg[drifting, None] / 6 * np.ones(3), rtol=1e-6
    )


def test_a_file_without_worlds_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="--count 0"):
        env.make_environments(tmp_path / "envs.zarr", count=0)
