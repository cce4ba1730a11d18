"""Damage on purpose, each kind found where it is; and flights again, the same or not."""

import json
import shutil

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import zarr

from angler_mjx.cli import main
from angler_mjx.learning.datasets import checksums, index, manifest
from angler_mjx.learning.datasets.verifying import integrity, replay, verification
from angler_mjx.learning.datasets.verifying.report import DatasetCheck
from angler_mjx.progress import Progress
from angler_mjx.runs.storage.checksums import hash_file


def verdict(folder, flights=0, workers=None):
    return verification.verify_dataset(folder, flights, Progress(), workers)


def with_new_sums(folder):
    """As somebody would leave it who changes data and hides it."""
    table = json.loads((folder / manifest.MANIFEST).read_text())
    (folder / manifest.MANIFEST).write_text(
        json.dumps({**table, "sums": checksums.write_checksums(folder)})
    )


def test_a_sound_dataset_flies_again_to_the_last_bit(made, capsys):
    main.main(["dataset", "verify", str(made), "--again", "1"])
    output = capsys.readouterr().out
    assert "1 episodes, 1 the same to the last bit" in output
    assert "0 wrong" not in output
    assert output.count("nothing wrong") == 5
    assert "5 episodes were not flown again" in output


def test_what_was_not_checked_is_said(made, capsys):
    main.main(["dataset", "verify", str(made)])
    output = capsys.readouterr().out
    assert output.count("nothing wrong") == 4
    assert "flown again: not checked: --again N flies N episodes again" in output
    main.main(["dataset", "verify", str(made), "--json"])
    checks = json.loads(capsys.readouterr().out)["checks"]
    assert checks["files"]["exact"] == len(checksums.list_files(made))
    assert (checks["parts"]["exact"], checks["index"]["exact"]) == (2, 6)
    assert (checks["values"]["exact"], checks["values"]["unchecked"]) == (0, 0)
    samples = 20
    assert checks["values"]["bounded"] == samples * (4 * 2 + 2 * 1)
    again = {key: checks["flown again"][key] for key in ("exact", "bounded", "unchecked")}
    assert again == {"exact": 0, "bounded": 0, "unchecked": 6}


@pytest.mark.parametrize(
    ("apart_m", "alike", "wrong"),
    [
        ([0.05] * 20, 20, 0),
        ([0.05] * 19 + [0.2], 20, 0),
        ([0.05] * 18 + [0.2, 0.2], 20, 1),
        ([], 20, 0),
        ([float("nan")] * 20, 18, 0),
        ([float("nan")] * 18 + [0.2, 0.05], 17, 2),
    ],
)
def test_robots_that_cannot_be_compared_are_not_counted_as_near(apart_m, alike, wrong):
    found = replay._ReplayComparison(at=50, robots=20, alike=alike, apart_m=apart_m, worlds=5)
    check = DatasetCheck(name="flown again")
    replay._check_bounds(check, found, ["jax"])
    assert len(check.findings) == wrong
    is_finite = np.isfinite(np.array(apart_m))
    near = int((np.array(apart_m)[is_finite] <= 0.1).sum())
    assert f"{near} of {is_finite.sum()} within 0.1 m after 10 s" in check.looked_at


def test_a_robot_that_broke_down_is_no_fault(copy):
    part = manifest.read_manifest(copy).parts[0].path
    array = zarr.open_group(copy / part / "trajectories.zarr", mode="r+")["outcome"]
    for number, faults in ((8, set()), (10, set()), (11, {"outcome"})):
        array[1, 15:, 1] = number
        with_new_sums(copy)
        found = [one for one in verdict(copy).findings if one.what == "values"]
        assert {one.where.rpartition("/")[2] for one in found} == faults


def test_files_that_were_changed_lost_or_added_are_named(copy):
    run = manifest.read_manifest(copy).parts[0].path
    shard = next((copy / run / "trajectories.zarr" / "nu").rglob("c/0/0/0/0"))
    data = bytearray(shard.read_bytes())
    data[len(data) // 3] ^= 1
    shard.write_bytes(data)
    (copy / run / "config.json").rename(copy / run / "config.jsonx")
    found = {(one.where, one.text.split(";")[0]) for one in verdict(copy, 2).findings}
    assert (
        f"{run}/trajectories.zarr/nu/c/0/0/0/0",
        "was changed or damaged (its SHA-256 differs)",
    ) in found
    assert (f"{run}/config.json", "is missing") in found
    assert (f"{run}/config.jsonx", "is no file of the dataset") in found


def test_the_list_of_sums_is_guarded_too(copy):
    with (copy / manifest.SUMS).open("a") as file:
        file.write(f"{'0' * 64}  ../elsewhere\n")
    (one,) = verdict(copy).findings
    assert "SHA-256 differs" in one.text
    table = json.loads((copy / manifest.MANIFEST).read_text())
    digest = hash_file(copy / manifest.SUMS)
    (copy / manifest.MANIFEST).write_text(json.dumps({**table, "sums": digest}))
    (one,) = verdict(copy).findings
    assert "leaves the dataset's folder" in one.text


def test_values_that_cannot_be_are_found_with_their_place(copy):
    part = manifest.read_manifest(copy).parts[0].path
    for name, at, value in (
        ("pwm_us", (1, 3, 0, 2), 2500.0),
        ("q", (0, 2, 1), 0.3),
        ("outcome", (1, 5, 1), 9),
    ):
        array = zarr.open_group(copy / part / "trajectories.zarr", mode="r+")[name]
        array[at] = value
    with_new_sums(copy)
    found = {one.where.rpartition("/")[2]: one.text for one in verdict(copy).findings}
    assert found.keys() == {"pwm_us", "q", "outcome"}
    assert "world 1, sample 3, robot 0" in found["pwm_us"]
    assert "world 0, sample 2, robot 1" in found["q"]


@pytest.fixture
def small_tasks(monkeypatch):
    """A task and a finding for each world: six of them in the dataset."""
    monkeypatch.setattr(integrity, "WORLDS_PER_TASK", 1)


def test_any_number_of_processes_finds_the_same_in_the_same_order(copy, small_tasks):
    first, second = manifest.read_manifest(copy).parts
    trajectories = copy / first.path / "trajectories.zarr"
    array = zarr.open_group(trajectories, mode="r+")["pwm_us"]
    array[0, 3, 0, 2], array[1, 4, 1, 0] = 2500.0, 900.0
    shard = trajectories / "p_m" / "c" / "1" / "0" / "0" / "0"
    shard.write_bytes(b"0" * 20 + shard.read_bytes()[20:])
    zarr.open_group(copy / second.path / "trajectories.zarr", mode="r+")["outcome"][1, 5, 0] = 11
    with_new_sums(copy)
    serial, parallel = (verdict(copy, workers=count) for count in (1, 2))
    assert serial == parallel
    values = [one for one in serial.findings if one.what == "values"]
    assert [(one.where, one.text.partition(",")[0]) for one in values[:2]] == [
        (f"{first.path}/trajectories.zarr/pwm_us", "world 0"),
        (f"{first.path}/trajectories.zarr/pwm_us", "world 1"),
    ]
    assert [one.where for one in values[2:]] == [
        first.path,
        f"{second.path}/trajectories.zarr/outcome",
    ]
    assert "p_m: cannot be read, it is damaged" in values[2].text
    assert "in 4 worlds" in serial.checks[3].looked_at


class Interrupted(Progress):
    """Ctrl-C after the values of one episode."""

    def describe(self, text):
        self.step = text

    def advance(self, amount, vehicle_steps=0):
        if self.step == "values":
            raise KeyboardInterrupt


def test_an_interruption_ends_the_checks(made, small_tasks):
    with pytest.raises(KeyboardInterrupt):
        verification.verify_dataset(made, 0, Interrupted())


def test_progress_goes_from_nothing_to_all(made):
    seen = {}

    class Counted(Progress):
        def start(self, total, done=0, unit="worlds"):
            self.state = [total, done, unit]

        def describe(self, text):
            seen[text] = self.state

        def advance(self, amount, vehicle_steps=0):
            self.state[1] += amount

    verification.verify_dataset(made, 0, Counted())
    n_files = len(checksums.list_files(made))
    assert seen == {
        "files": [n_files, n_files, "files"],
        "parts": [2, 2, "parts"],
        "index": [6, 6, "episodes"],
        "values": [6, 6, "episodes"],
    }


def test_processes_are_as_many_as_the_episodes_are_worth(made, monkeypatch):
    monkeypatch.setattr(integrity, "cpu_count", lambda: 16)
    small = manifest.read_manifest(made)
    large = small.model_copy(
        update={"parts": [part.model_copy(update={"worlds": 10_000}) for part in small.parts]}
    )
    assert [integrity.count_processes(small, count) for count in (None, 1, 8)] == [0, 1, 2]
    assert [integrity.count_processes(large, count) for count in (None, 1, 32)] == [10, 1, 32]


def test_an_index_that_was_edited_is_found(copy):
    table = pq.read_table(copy / manifest.INDEX)
    split = ["train"] * len(table)
    at = table.schema.get_field_index("split")
    pq.write_table(table.set_column(at, table.schema.field(at), [split]), copy / manifest.INDEX)
    with_new_sums(copy)
    assert {one.where for one in verdict(copy).findings} == {"index.parquet, split"}


def test_an_environment_in_two_splits_is_found():
    splits = ["train", "val", "test", "val"]
    table = pa.table({"environment": ["a", "b", "a", "b"], "split": splits})
    assert index.find_shared_environment(table) == ("test", "train", "a")
    assert index.find_shared_environment(table.slice(1)) is None


@pytest.mark.nightly(
    by="tests/angler_mjx/learning/datasets/test_verifying.py::test_a_sound_dataset_flies_again_to_the_last_bit"
)
def test_flights_that_come_out_otherwise_are_found(copy):
    """One bit of a plan's time: nobody sees it, and the flight again does."""
    part = manifest.read_manifest(copy).parts[0]
    array = zarr.open_group(copy / part.path / "trajectories.zarr", mode="r+")["end/p_m"]
    whole = np.asarray(array[:])
    whole[:, 0, 0] = np.nextafter(whole[:, 0, 0], np.float32(np.inf))
    array[:] = whole
    with_new_sums(copy)
    (first,) = verdict(copy, 1).findings
    assert first.where == f"{part.path}/trajectories.zarr/end/p_m"
    assert "when flown again" in first.text


@pytest.mark.nightly(
    by="tests/angler_mjx/learning/datasets/test_verifying.py::test_a_sound_dataset_flies_again_to_the_last_bit"
)
def test_elsewhere_flights_are_held_to_how_far_they_may_part(copy, made):
    table = json.loads((copy / manifest.MANIFEST).read_text())
    versions = {**table["environment"]["versions"], "jax": "0.0.1"}
    table["environment"]["versions"] = versions
    (copy / manifest.MANIFEST).write_text(json.dumps(table))
    report = verdict(copy, 1)
    assert report.agrees
    assert "made with another jax; 2 of 2 robots ended alike" in report.checks[-1].looked_at
    assert replay.environment_differences(manifest.read_manifest(made)) == []


def test_worlds_are_chosen_in_one_tile_of_each_part(made):
    parts = manifest.read_manifest(made).parts
    for count in (1, 2, 3, 6):
        chosen = replay.select_worlds(parts, count)
        assert sum(len(worlds) for _, worlds in chosen) <= count
        for part, worlds in chosen:
            assert len({world // part.tile for world in worlds}) == 1
            assert 0 <= min(worlds) <= max(worlds) < part.worlds
    # The seed says which tile; the last one may be smaller than the others.
    part = parts[0].model_copy(update={"worlds": 5, "tile": 2})
    chosen = {
        seed: replay.select_worlds([part.model_copy(update={"seed": seed})], 5)[0][1]
        for seed in range(4)
    }
    assert chosen == {0: [0, 1], 1: [2, 3], 2: [4], 3: [0, 1]}


@pytest.mark.parametrize("name", ["dataset.json", "index.parquet", "sha256sums.txt"])
def test_what_is_missing_is_said_in_one_line(copy, name, capsys):
    (copy / name).unlink()
    with pytest.raises(SystemExit) as ended:
        main.main(["dataset", "verify", str(copy)])
    assert ended.value.code == (2 if name == "dataset.json" else 1)
    output = capsys.readouterr()
    assert name in output.out + output.err
    shutil.rmtree(copy)
