"""Arrays, episodes and statistics against Zarr and the runs; orders and loaders of windows."""

import itertools

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import zarr

from angler_mjx.errors import ConfigError
from angler_mjx.learning import datasets
from angler_mjx.learning.datasets import manifest
from angler_mjx.learning.datasets.loaders import shuffling
from angler_mjx.learning.datasets.stored import StoredArray
from angler_mjx.runs.storage import trajectory_layout
from angler_mjx.runs.storage.folder import Run

TIMED = [name for name, kind in trajectory_layout.ARRAYS.items() if kind.dims[:1] == ("time",)]


@pytest.fixture(scope="module")
def data(made):
    return datasets.open(made)


def runs(root):
    return [root / part.path for part in manifest.read_manifest(root).parts]


def test_every_value_is_that_of_zarr(made):
    looked_at = set()
    for run in runs(made):
        group = zarr.open_group(run / "trajectories.zarr", mode="r")
        for name, array in group.members(max_depth=None):
            if name in trajectory_layout.ARRAYS:
                read_array = StoredArray(run / "trajectories.zarr" / name)
                assert read_array.shape == array.shape
                looked_at.add((name, read_array._source.per_unit is not None))
                np.testing.assert_array_equal(read_array.read_worlds(0, 2), array[0:2])
                np.testing.assert_array_equal(read_array.read_worlds(1, 2), array[1:2])
                for world in range(array.shape[0]):
                    theirs = np.asarray(array[world])
                    read = read_array.read(world)
                    assert read.dtype == theirs.dtype
                    np.testing.assert_array_equal(read, theirs)
                    if name in TIMED:
                        some = slice(3, 12, 2)
                        np.testing.assert_array_equal(read_array.read(world, some), theirs[some])
    assert {("p_m", True), ("nu", True), ("q", False), ("outcome", False)} <= looked_at


@pytest.mark.parametrize("codecs", ["exact", "stepped"])
def test_worlds_that_were_never_written_are_missing(tmp_path, codecs):
    from angler_mjx.runs.storage.quantization import build_quantization

    steps = build_quantization(1e-3, "m")
    more = {"filters": steps.filters(3), "compressors": steps.compressor()}
    zarr.create_array(
        tmp_path / "a",
        shape=(4, 5, 3),
        chunks=(1, 5, 3),
        shards=(2, 5, 3),
        dtype="float32",
        fill_value=np.nan,
        **(more if codecs == "stepped" else {"compressors": zarr.codecs.BloscCodec(cname="lz4")}),
    )[1] = 2.0
    read_array = StoredArray(tmp_path / "a")
    assert np.isnan(read_array.read(0)).all()
    assert (read_array.read(1) == 2.0).all()
    both = read_array.read_worlds(0, 2)
    np.testing.assert_array_equal(both, np.stack([read_array.read(0), read_array.read(1)]))
    for read in (read_array.read, lambda world: read_array.read_worlds(world - 1, world + 1)):
        with pytest.raises(ConfigError, match="no such file"):
            read(2)
        with pytest.raises(IndexError):
            read(4)


def test_arrays_of_others_are_left_to_zarr(tmp_path):
    values = np.arange(24.0).reshape(2, 4, 3)
    zarr.create_array(tmp_path / "a", data=values, chunks=(1, 2, 3))
    read_array = StoredArray(tmp_path / "a")
    np.testing.assert_array_equal(read_array.read(1), values[1])
    np.testing.assert_array_equal(read_array.read(1, slice(1, 3)), values[1, 1:3])
    np.testing.assert_array_equal(read_array.read_worlds(0, 2), values)


def test_damaged_shards_are_named(copy):
    root = runs(copy)[0] / "trajectories.zarr" / "p_m"
    shard = root / "c" / "0" / "0" / "0" / "0"
    whole = shard.read_bytes()
    for damaged, message in (
        (whole[:-40], "its index is wrong"),
        (b"", "cannot be read"),
    ):
        shard.write_bytes(damaged)
        fresh = StoredArray(root)
        with pytest.raises(ConfigError, match=message):
            fresh.read(0)
    shard.unlink()
    with pytest.raises(ConfigError, match="no such file"):
        StoredArray(root).read(0)


def test_episodes_are_what_the_runs_hold(data, made):
    for i in range(len(data)):
        episode = data.episode(i)
        run = Run(runs(made)[episode.about["part"]])
        world, n = episode.about["world"], episode.about["samples"]
        for name, values in episode.arrays.items():
            np.testing.assert_array_equal(values, np.asarray(run.trajectories[name][world][:n]))
        np.testing.assert_array_equal(episode.plan_m, run.trajectories["plan_m"][world])
        rows = [row for row in run.episodes.to_pylist() if row["world"] == world]
        assert episode.outcomes == tuple(row["outcome"] for row in rows)
        for robot, row in enumerate(rows):
            end = row["time_to_goal_s"] or row["failure_time_s"]
            running = episode.time_s < end - 1e-6
            np.testing.assert_array_equal(episode.running[:, robot], running)
        assert episode.environment["grid/occupied"].ndim == 3


def test_only_what_is_asked_for_is_opened(made):
    assert len(datasets.open(made, split="test_there")) == 2
    there = set(datasets.open(made).index["split"].to_pylist())
    assert sum(len(datasets.open(made, split=name)) for name in there) == 6
    with pytest.raises(ConfigError, match="split: 'training' is not among"):
        datasets.open(made, split="training")
    with pytest.raises(ConfigError, match="fields: 'speed' is not among"):
        datasets.open(made, fields=("speed",))
    arrived = set(datasets.open(made).index["success"].to_pylist())
    assert sum(len(datasets.open(made, success=one)) for one in arrived) == 6
    if len(arrived) == 1:
        with pytest.raises(ConfigError, match="no episode is left"):
            datasets.open(made, success=not arrived.pop())


def test_a_run_folder_is_a_dataset_too(made):
    run = runs(made)[0]
    whole, alone = datasets.open(made), datasets.open(run)
    assert len(alone) == 4
    a, b = whole.windows(6)[3], alone.windows(6)[3]
    for name in ("p_m", "q", "mask"):
        np.testing.assert_array_equal(a[name], b[name])


def test_statistics_are_those_of_running_robots(data):
    found = data.statistics()
    values = np.concatenate(
        [
            episode.arrays["nu"][episode.running]
            for episode in (data.episode(i) for i in range(len(data)))
        ]
    ).astype(float)
    np.testing.assert_allclose(found["nu"][0], values.mean(axis=0), atol=1e-6)
    np.testing.assert_allclose(found["nu"][1], values.std(axis=0), atol=1e-5)


def test_statistics_leave_padding_out_and_tell_vehicles_apart(copy):
    """The second robot as one of six thrusters, whose last two columns are neutral."""
    run = Run(runs(copy)[0])
    label = pa.array(["bluerov2_heavy", "bluerov2"] * 4)
    at = run.episodes.schema.get_field_index("vehicle")
    field = run.episodes.schema.field(at)
    pq.write_table(
        run.episodes.set_column(at, field, label.cast(field.type)), run.path / "episodes.parquet"
    )
    group = zarr.open_group(run.path / "trajectories.zarr", mode="r+")
    pwm = np.asarray(group["pwm_us"][:])
    pwm[:, :, 1, 6:] = 1500.0
    pwm[:, 2, 0] = 0.0  # no command: as of a robot that diverged
    group["pwm_us"][:] = pwm
    exist = np.ones((4, 2), bool)
    exist[:, 1] = False
    group["environment/obstacles/exists"][:] = exist
    data = datasets.open(run.path)
    assert data.vehicles == ("bluerov2", "bluerov2_heavy")
    running = np.asarray(group["outcome"][:]) == 0
    samples = [data.samples[i] for i in range(4)]
    by_robot = [
        np.concatenate([pwm[i, :n, robot][running[i, :n, robot]] for i, n in enumerate(samples)])
        for robot in range(2)
    ]
    by_robot[0] = by_robot[0][by_robot[0][:, 0] > 0.0].astype(float)
    assert len(by_robot[0]) == len(by_robot[1]) - 4
    both = [np.concatenate([one[:, k] for one in by_robot]) for k in range(6)]
    both += [by_robot[0][:, 6], by_robot[0][:, 7]]
    for vehicle, wanted in (
        (None, both),
        ("bluerov2_heavy", list(by_robot[0].T)),
        ("bluerov2", list(by_robot[1][:, :6].T)),
    ):
        mean, std = data.statistics(vehicle=vehicle)["pwm_us"]
        width = len(wanted)
        np.testing.assert_allclose(mean[:width], [one.mean() for one in wanted], rtol=1e-5)
        np.testing.assert_allclose(std[:width], [one.std() for one in wanted], rtol=2e-3)
        assert np.isnan(mean[width:]).all()
        assert len(mean) == 8
    positions = np.concatenate(
        [np.asarray(group["obstacle_p_m"][i, :n, 0]) for i, n in enumerate(samples)]
    )
    np.testing.assert_allclose(
        data.statistics()["obstacle_p_m"][0], positions.mean(axis=0, dtype=float), rtol=1e-4
    )
    assert all((window["obstacle_mask"] == [True, False]).all() for window in data.windows(4))
    with pytest.raises(ConfigError, match="vehicle: 'boat' is not among bluerov2, bluerov2_heavy"):
        data.statistics(vehicle="boat")


def test_orders_can_be_had_again_and_are_shared_without_a_gap(data):
    windows = data.windows(3)
    first = shuffling.shuffle_windows(windows, 7, 0, group=2)
    assert sorted(first.tolist()) == list(range(len(windows)))
    np.testing.assert_array_equal(first, shuffling.shuffle_windows(windows, 7, 0, group=2))
    assert not np.array_equal(first, shuffling.shuffle_windows(windows, 7, 1, group=2))
    assert not np.array_equal(first, shuffling.shuffle_windows(windows, 8, 0, group=2))
    # Groups: the windows of the first two episodes come before all others.
    episodes = np.searchsorted(windows.ends, first, side="right")
    two = {int(episodes[0])}
    at = 0
    while len(two | {int(episodes[at])}) <= 2:
        two.add(int(episodes[at]))
        at += 1
    assert not two & set(episodes[at:].tolist())
    for readers in (1, 2, 3):
        parts = [
            list(shuffling.shard_numbers(first, start=5, index=i, of=readers))
            for i in range(readers)
        ]
        assert sorted(itertools.chain(*parts)) == sorted(first[5:].tolist())
    with pytest.raises(ConfigError, match="seed = -1"):
        shuffling.shuffle_windows(windows, -1, 0)


def test_pytorch_sees_every_window_once_whatever_shares_it(data):
    pytest.importorskip("torch", reason="PyTorch is not installed")
    from torch.utils.data import DataLoader

    from angler_mjx.learning.datasets.loaders.torch import WindowDataset, WindowStream

    windows = data.windows(4)
    window = WindowDataset(windows)[1]
    np.testing.assert_array_equal(window["p_m"].numpy(), windows[1]["p_m"])
    seen = []
    for rank in range(2):
        stream = WindowStream(windows, seed=1, rank=rank, world_size=2, group=2)
        stream.load_state_dict({"seed": 1, "epoch": 3, "seen": 4})
        loader = DataLoader(
            stream, batch_size=4, num_workers=2, multiprocessing_context="forkserver"
        )
        for batch in loader:
            seen += list(zip(batch["episode"].tolist(), batch["first"].tolist(), strict=True))
    numbers = shuffling.shuffle_windows(windows, 1, 3, group=2)[4:]
    wanted = [(int(windows[i]["episode"]), int(windows[i]["first"])) for i in numbers.tolist()]
    assert sorted(seen) == sorted(wanted)
    assert stream.state_dict() == {"seed": 1, "epoch": 3, "seen": 4}


def test_grain_goes_on_where_it_was(data):
    pytest.importorskip("grain", reason="Grain is not installed")
    from angler_mjx.learning.datasets.loaders.grain import build_source

    def begun():
        return iter(build_source(data.windows(4)).shuffle(seed=3).batch(2).to_iter_dataset())

    first = begun()
    for _ in range(3):
        next(first)
    state = first.get_state()
    wanted = [next(first)["first"].tolist() for _ in range(3)]
    again = begun()
    again.set_state(state)
    assert [next(again)["first"].tolist() for _ in range(3)] == wanted


def test_xarray_opens_the_trajectories(data):
    pytest.importorskip("xarray", reason="xarray is not installed")
    found = data.xarray(0)
    assert found["p_m"].dims == ("world", "time", "robot", "xyz")
    values = data.values(0, "p_m")
    np.testing.assert_array_equal(found["p_m"][0].values[: len(values)], values)
