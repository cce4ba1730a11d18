"""Environments on disk: what is written is read, and nothing half-written is left."""

import errno

import jax
import numpy as np
import pytest
import zarr

from angler_mjx.cli import env
from angler_mjx.errors import ConfigError, RunError
from angler_mjx.files import parse
from angler_mjx.storage import environments as store
from angler_mjx.world.config import WorldConfig
from angler_mjx.world.generate import generate_batch

RADIUS = np.array([0.4, 0.4])
CONFIG = parse(
    WorldConfig,
    {
        "preset": "corridor",
        "shape": [9, 6, 5],
        "currents": [{"type": "vortices", "count": 2, "peak_speed_mps": [0.1, 0.3]}],
        "obstacles": {"dynamic": {"count": 2}},
    },
    source="test",
)


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    """Seven worlds in tiles of three: the last tile is not full."""
    path = tmp_path_factory.mktemp("store") / "envs.zarr"
    assert store.make(path, CONFIG, RADIUS, 3, 7, tile=3) == 0
    return path


def test_what_is_read_is_what_was_generated(file):
    made = generate_batch(CONFIG, RADIUS, 3, 3, 3)
    group = store.open_file(file)
    batch = store.read(group, slice(3, 6))
    assert jax.tree.structure(batch) == jax.tree.structure(made)
    jax.tree.map(np.testing.assert_array_equal, batch, made)
    one = store.read(group, 4)
    jax.tree.map(lambda a, b: np.testing.assert_array_equal(a, b[1]), one, made)


def test_arrays_say_their_units(file):
    group = store.open_file(file)
    assert group["valid"].shape == (7,)
    units = {
        "start_m": "m",
        "start_yaw_rad": "rad",
        "current/0/circulation_m2ps": "m^2/s",
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
        store.make(file, CONFIG, RADIUS, 3, 7)
    assert sorted(file.rglob("*")) == before


def test_a_full_disk_leaves_nothing(tmp_path, monkeypatch):
    def full(group, first, environment):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(store, "write", full)
    with pytest.raises(RunError, match="No space left"):
        store.make(tmp_path / "envs.zarr", CONFIG, RADIUS, 3, 3, tile=3)
    assert list(tmp_path.iterdir()) == []


def test_interruption_leaves_nothing(tmp_path):
    def interrupt(done):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        store.make(tmp_path / "envs.zarr", CONFIG, RADIUS, 3, 6, tile=3, advance=interrupt)
    assert list(tmp_path.iterdir()) == []


def test_other_files_are_refused(tmp_path):
    zarr.open_group(tmp_path / "other.zarr", mode="w")
    for name in ("other.zarr", "nothing.zarr"):
        with pytest.raises(ConfigError, match=name):
            store.open_file(tmp_path / name)


def test_a_picture_of_a_stored_world(file, tmp_path):
    picture = tmp_path / "env.png"
    env.show(file, index=2, out=picture)
    assert picture.read_bytes().startswith(b"\x89PNG")
    with pytest.raises(ConfigError, match="0 to 6"):
        env.show(file, index=7, out=picture)


def test_the_command_makes_a_file(tmp_path, capsys):
    path = tmp_path / "envs.zarr"
    env.make(path, preset="corridor", count=2, robots=1, tile=2)
    assert capsys.readouterr().out.strip().endswith(str(path))
    assert store.read(store.open_file(path), 1).goal_m.shape == (1, 3)
    with pytest.raises(ConfigError, match="--count 0"):
        env.make(path, count=0)
