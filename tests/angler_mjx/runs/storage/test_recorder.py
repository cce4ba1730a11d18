"""Tiles as files of a Zarr group: what Zarr reads is what was written, whatever the blocks."""

import jax
import numpy as np
import pytest
import zarr

from angler_mjx.runs.storage import environments as store
from angler_mjx.runs.storage import recorder, shards
from angler_mjx.runs.storage.device_to_host import (
    FinishedTile,
    LastState,
    TileConstants,
    TileEnd,
    recorded_arrays,
)
from angler_mjx.runs.storage.recorder import Recorder, TrajectoryShape
from angler_mjx.sim.record import FIELDS, Sample

from ...report.conftest import make_environment

TILE, SAMPLES, ROBOTS, OBSTACLES = 4, 6, 2, 3
SHAPE = TrajectoryShape(
    worlds=7, samples=SAMPLES, robots=ROBOTS, thrusters=8, obstacles=OBSTACLES, plan_points=5
)


@pytest.fixture(scope="module")
def environment():
    rng = np.random.default_rng(1)
    worlds = [make_environment(rng, (4, 4, 4), n_obstacle=OBSTACLES) for _ in range(TILE)]
    return jax.tree.map(lambda *leaves: np.stack(leaves), *worlds)


def make_tile(environment, first, kept, rng):
    """A tile that had ended after five of six samples."""

    def part(n):
        values = {}
        for field in (field for field in FIELDS if not field.is_optional):
            lead = (TILE, n, *field.shape(SHAPE.sizes))
            values[field.path[0]] = rng.normal(size=lead).astype(np.float32)
            if field.about.whole:
                values[field.path[0]] = rng.integers(0, 8, lead).astype(np.int32)
        pwm = 1500 + 100 * values["pwm_us"]
        pwm[0, 0, 0, 1] = np.nan
        return Sample(**{**values, "pwm_us": pwm})

    constants = TileConstants(
        valid=None,
        variant=None,
        planned=None,
        columns={},
        environment=environment,
        plan={
            "plan_time_s": rng.normal(size=(TILE, ROBOTS, 5)).astype(np.float32),
            "plan_m": rng.normal(size=(TILE, ROBOTS, 5, 3)).astype(np.float32),
        },
    )
    last = LastState(
        step=np.full(TILE, 5, np.int32),
        p=rng.normal(size=(TILE, ROBOTS, 3)).astype(np.float32),
        q=rng.normal(size=(TILE, ROBOTS, 4)).astype(np.float32),
        nu=rng.normal(size=(TILE, ROBOTS, 6)).astype(np.float32),
        outcome=rng.integers(1, 8, (TILE, ROBOTS)).astype(np.int32),
        obstacle_p=rng.normal(size=(TILE, OBSTACLES, 3)).astype(np.float32),
        obstacle_q=rng.normal(size=(TILE, OBSTACLES, 4)).astype(np.float32),
    )
    end = TileEnd(tally=None, p=None, last=last)
    parts = [part(3), part(2)]
    return FinishedTile(first=first, kept=kept, constants=constants, end=end, parts=parts)


def write_all(path, environment):
    made = Recorder.create(path, SHAPE, environment, tile=TILE, sample_dt_s=0.1)
    rng = np.random.default_rng(0)
    tiles = [make_tile(environment, 0, 4, rng), make_tile(environment, 4, 3, rng)]
    written = [
        made.write(tile.first, recorded_arrays(tile, SAMPLES), environment) for tile in tiles
    ]
    return tiles, written


def files(path):
    return {p.relative_to(path): p.read_bytes() for p in path.rglob("*") if p.is_file()}


@pytest.fixture(scope="module")
def written(environment, tmp_path_factory):
    path = tmp_path_factory.mktemp("recorder") / "run.zarr"
    return path, *write_all(path, environment)


def test_zarr_reads_what_was_written(written):
    path, tiles, _ = written
    group = zarr.open_group(path, mode="r")
    for tile in tiles:
        here = slice(tile.first, tile.first + tile.kept)
        for name, field in {"p_m": "p", "nu": "nu", "obstacle_q": "obstacle_q"}.items():
            parts = [getattr(part, field)[: tile.kept] for part in tile.parts]
            np.testing.assert_array_equal(group[name][here, :5], np.concatenate(parts, axis=1))
            assert np.isnan(group[name][here, 5]).all()
        outcome = np.concatenate([part.outcome[: tile.kept] for part in tile.parts], axis=1)
        np.testing.assert_array_equal(group["outcome"][here, :5], outcome)
        np.testing.assert_array_equal(group["outcome"][here, 5], outcome[:, 4])
        pwm = np.concatenate([part.pwm_us[: tile.kept] for part in tile.parts], axis=1)
        expected = np.where(np.isnan(pwm), 0, pwm)  # to the last bit: half a us is 2 % of its power
        np.testing.assert_array_equal(group["pwm_us"][here, :5], expected)
        np.testing.assert_array_equal(
            group["plan_m"][here], tile.constants.plan["plan_m"][: tile.kept]
        )


def test_the_state_after_the_last_sample_is_kept(written):
    path, tiles, _ = written
    group = zarr.open_group(path, mode="r")
    for tile in tiles:
        here, last = slice(tile.first, tile.first + tile.kept), tile.end.last
        for name, values in {
            "step": last.step,
            "p_m": last.p,
            "q": last.q,
            "nu": last.nu,
            "outcome": last.outcome,
            "obstacle_p_m": last.obstacle_p,
            "obstacle_q": last.obstacle_q,
        }.items():
            np.testing.assert_array_equal(group[f"end/{name}"][here], values[: tile.kept], name)


def test_arrays_say_what_they_hold(written):
    path, _, _ = written
    group = zarr.open_group(path, mode="r")
    pwm = group["pwm_us"]
    assert pwm.metadata.dimension_names == ("world", "time", "robot", "thruster")
    assert (pwm.dtype, pwm.attrs["unit"]) == (np.float32, "us")
    assert group["obstacle_q"].metadata.dimension_names == ("world", "time", "obstacle", "wxyz")
    assert group["outcome"].attrs["description"].startswith("0 running, 1 reached")
    assert group["plan_m"].metadata.dimension_names == ("world", "robot", "way_point", "xyz")
    assert "estimate" not in group


def test_environments_are_what_the_store_would_have_written(written, environment, tmp_path):
    path, _, _ = written
    theirs = zarr.open_group(tmp_path / "theirs.zarr", mode="w-")
    store.create_arrays(theirs, environment, SHAPE.worlds, TILE)
    for first in (0, 4):
        store.write_batch(theirs, first, environment)
    ours = zarr.open_group(path, mode="r")["environment"]
    for name in store.named_leaves(environment):
        np.testing.assert_array_equal(ours[name][...], theirs[name][...], err_msg=name)
    assert store.read_environments(ours, 5).obstacles.kinds == environment.obstacles.kinds


def test_threads_and_blocks_change_no_byte(written, environment, tmp_path, monkeypatch):
    path, _, sizes = written
    monkeypatch.setattr(recorder, "BLOCK_BYTES", 1)
    monkeypatch.setattr(recorder, "ENCODER_THREADS", 1)
    monkeypatch.setattr(recorder, "WRITER_THREADS", 1)
    _, others = write_all(tmp_path / "run.zarr", environment)
    assert others == sizes
    assert files(tmp_path / "run.zarr") == files(path)


def test_the_bytes_told_are_those_on_disk(written):
    path, _, sizes = written
    recorded = [
        file
        for file in path.rglob("c/**/*")
        if file.is_file() and "environment" not in file.parts and "time_s" not in file.parts
    ]
    assert sum(sizes) == sum(file.stat().st_size for file in recorded)


def test_a_failed_write_leaves_no_file_and_is_told(environment, tmp_path, monkeypatch):
    made = Recorder.create(tmp_path / "run.zarr", SHAPE, environment, tile=TILE, sample_dt_s=0.1)
    tile = make_tile(environment, 0, 4, np.random.default_rng(0))

    def full(file, data):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(shards, "_write_all", full)
    with pytest.raises(OSError, match="No space left"):
        made.write(0, recorded_arrays(tile, SAMPLES), environment)
    assert [p for p in (tmp_path / "run.zarr" / "p_m").rglob("c/**/*") if p.is_file()] == []


def test_an_empty_shard_is_an_index_alone(tmp_path):
    place = tmp_path / "c" / "0"
    assert shards.write_shard(place, [], shard=3) == 3 * 16 + 4
    assert place.read_bytes()[:48] == b"\xff" * 48
