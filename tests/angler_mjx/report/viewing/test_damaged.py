"""Damaged run folders: whatever was done to a file, only our own errors, and they name the folder.

Several hundred mutations of one small run: files cut, overwritten, emptied, gone, JSON with other
values and types, descriptions of other arrays.
"""

import json
import shutil
import sys

import numpy as np
import pytest

from angler_mjx.errors import AnglerError, ConfigError
from angler_mjx.report.interop import mcap
from angler_mjx.report.plotting import scene
from angler_mjx.report.viewing.world_selection import good_world, worst_world
from angler_mjx.runs.storage import environments, folder, input_copies
from angler_mjx.runs.storage.folder import Run

VALUES = (None, True, -1, 0, 10**9, 10**30, 1e300, "x", "../../etc", [], {}, [[]], [{"a": 1}])
"""What stands in JSON in place of the right value."""


def daily(test):
    """Some of the mutations are tried every time, all of them at night."""
    rest = pytest.param(False, marks=pytest.mark.nightly(by=f"{test}[True]"))
    return pytest.mark.parametrize("few", [True, rest])


@pytest.fixture(scope="session")
def whole(run, tmp_path_factory):
    """The run with all that a real one has beside its arrays."""
    path = tmp_path_factory.mktemp("whole") / "run"
    shutil.copytree(run.path, path)
    (path / "summary.json").write_text(json.dumps({"complete": False, "worlds": 2}))
    (path / "environment.json").write_text(json.dumps({"versions": {}, "commit": None}))
    input_copies.copy_inputs(path, ["bluerov2_heavy", "bluerov2"])
    return path


def use_all(path):
    """Everything that reads a run folder, from the summary to the pictures' numbers."""
    run = Run(path)
    _ = run.summary, run.environment, run.scenario
    assert run.episodes.num_rows == 8
    assert {worst_world(run), good_world(run)} <= {0, 1}
    assert len(scene.read_scene(run, 0).robots) == 4


def assert_ours(path, what):
    """Reading ends well, or in an error of ours."""
    said = ""
    try:
        use_all(path)
    except AnglerError as error:
        said = str(error)
    except Exception as error:
        pytest.fail(f"{what}: {type(error).__name__}: {error}")
    assert len(said) < 2000, what


def files_of(path):
    found = (p.relative_to(path) for p in path.rglob("*") if p.is_file())
    return sorted(found, key=str)


def mutate(data, rng):
    """Bytes cut, emptied, or some of them other ones."""
    kind = rng.integers(4)
    if kind == 0:
        return data[: rng.integers(len(data) + 1)]
    if kind == 1:
        return rng.bytes(len(data))
    out = bytearray(data)
    for at in rng.integers(0, len(data), 1 + int(rng.integers(8))) if data else []:
        out[at] = rng.integers(256)
    return bytes(out) if kind == 2 else bytes(out) + rng.bytes(7)


def places_in(value, path=()):
    """Paths to everything in a JSON value."""
    yield path
    pairs = value.items() if isinstance(value, dict) else ()
    for key, inner in enumerate(value) if isinstance(value, list) else pairs:
        yield from places_in(inner, (*path, key))


def replaced(value, path, new):
    if not path:
        return new
    copy = dict(value) if isinstance(value, dict) else list(value)
    copy[path[0]] = replaced(copy[path[0]], path[1:], new)
    return copy


def test_the_whole_run_can_be_read(whole, tmp_path):
    use_all(whole)
    mcap.export_bag(Run(whole), tmp_path / "out.mcap", [0])


@daily("test_bytes_changed_anywhere")
def test_bytes_changed_anywhere(whole, tmp_path, few):
    path = tmp_path / "run"
    shutil.copytree(whole, path)
    count = 0
    for number, name in enumerate(files_of(whole)):
        before = (whole / name).read_bytes()
        for seed in range(1 if few or "environment" in name.parts else 3):
            (path / name).write_bytes(mutate(before, np.random.default_rng([number, seed])))
            assert_ours(path, f"{name}, seed {seed}")
            count += 1
        (path / name).write_bytes(before)
    assert count > 100


@daily("test_files_that_are_gone")
def test_files_that_are_gone(whole, tmp_path, few):
    path = tmp_path / "run"
    shutil.copytree(whole, path)
    names = files_of(whole)
    # The arrays of an environment are read in one loop: every fifth file of them.
    of_worlds = [name for name in names if "environment" in name.parts]
    for name in sorted({*names} - {*of_worlds}) + of_worlds[:: 5 if few else 1]:
        before = (path / name).read_bytes()
        (path / name).unlink()
        assert_ours(path, f"{name} gone")
        (path / name).write_bytes(before)
    for name in ("p_m", "plan_m", "environment/goal_m", "environment/grid", "time_s"):
        shutil.move(path / "trajectories.zarr" / name, tmp_path / "aside")
        with pytest.raises(ConfigError, match="trajectories"):
            use_all(path)
        shutil.move(tmp_path / "aside", path / "trajectories.zarr" / name)


JSON = (
    "config.json",
    "summary.json",
    "environment.json",
    "inputs/inputs.json",
    "trajectories.zarr/zarr.json",
    "trajectories.zarr/p_m/zarr.json",
    "trajectories.zarr/time_s/zarr.json",
    "trajectories.zarr/environment/zarr.json",
    "trajectories.zarr/environment/goal_m/zarr.json",
)


@pytest.mark.parametrize("name", JSON)
@daily("test_other_values_in_json")
def test_other_values_in_json(whole, tmp_path, name, few):
    path = tmp_path / "run"
    shutil.copytree(whole, path)
    table = json.loads((whole / name).read_text())
    rng = np.random.default_rng(JSON.index(name))
    places = list(places_in(table))
    chosen = rng.choice(len(places), min(8 if few else 20, len(places)), replace=False)
    for at in chosen:
        new = VALUES[rng.integers(len(VALUES))]
        (path / name).write_text(json.dumps(replaced(table, places[at], new)))
        assert_ours(path, f"{name} {places[at]} = {new!r}")
    deep = "[" * 100_000 + "]" * 100_000
    (path / name).write_text(deep)
    assert sys.getrecursionlimit() < 100_000
    with pytest.raises(ConfigError, match="run"):
        use_all(path)


def test_environments_are_read_as_a_file_of_their_own(whole, tmp_path):
    path = tmp_path / "run"
    shutil.copytree(whole, path)
    group = environments.open_environments(path)
    assert np.asarray(environments.read_environments(group, 1).goal_m).shape == (4, 3)
    place = path / "trajectories.zarr" / "environment" / "goal_m" / "zarr.json"
    table = json.loads(place.read_text())
    place.write_text(json.dumps(table | {"shape": [2, 4, 7]}))
    with pytest.raises(ConfigError, match=r"goal_m: has the shape \(2, 4, 7\)"):
        environments.open_environments(path)
    table["attributes"] = {}
    (path / "trajectories.zarr" / "environment" / "zarr.json").write_text('{"zarr_format": 3}')
    with pytest.raises(ConfigError, match="environment: holds no environments"):
        environments.open_environments(path)


def test_an_array_that_claims_to_be_huge_is_refused_before_it_is_read(whole, tmp_path):
    path = tmp_path / "run"
    shutil.copytree(whole, path)
    place = path / "trajectories.zarr" / "p_m" / "zarr.json"
    table = json.loads(place.read_text())
    table["shape"][1] = 10**11
    place.write_text(json.dumps(table))
    with pytest.raises(ConfigError, match=r"p_m: is described as float32 \(2, 100000000000"):
        _ = Run(path).trajectories


def test_plans_that_lack_a_part_are_refused(jointed, tmp_path):
    whole, motion = jointed
    assert motion.keys() <= set(whole.trajectories)
    for name in motion:
        path = tmp_path / name
        shutil.copytree(whole.path, path)
        shutil.rmtree(path / "trajectories.zarr" / name)
        with pytest.raises(ConfigError, match=f"{name}: is missing"):
            _ = Run(path).trajectories


def test_a_copy_that_was_changed_is_refused(whole, tmp_path):
    path = tmp_path / "run"
    shutil.copytree(whole, path)
    copy = path / "inputs" / "vehicles" / "bluerov2.toml"
    copy.write_text(copy.read_text().replace("BlueROV2", "Other"))
    with pytest.raises(ConfigError, match=r"vehicles/bluerov2\.toml: is not the copy"):
        input_copies.read_inputs(path)
    listed = path / "inputs" / "inputs.json"
    listed.write_text(listed.read_text().replace("vehicles/bluerov2.toml", "../../bluerov2.toml"))
    with pytest.raises(ConfigError, match="leads out of the folder"):
        input_copies.read_inputs(path)


def test_a_damaged_run_cannot_be_resumed(whole, tmp_path):
    path = tmp_path / "run"
    shutil.copytree(whole, path)
    (path / "config.json").write_text('{"schema_version": 1, ')
    with pytest.raises(ConfigError, match=r"config\.json: cannot be read"):
        folder.read_scenario(path)
    (path / "summary.json").write_text("[1]")
    with pytest.raises(ConfigError, match=r"summary\.json: cannot be read"):
        folder.reopen_folder(path, print)
    assert path.is_dir()


def test_old_rows_with_nan_are_read_as_nulls(run, tmp_path):
    import pyarrow as pa
    import pyarrow.parquet as pq

    table = run.episodes
    old = table.column("time_to_goal_s").fill_null(float("nan"))
    alone = pa.chunked_array([pa.array([np.inf] * table.num_rows, pa.float32())])
    at = table.schema.get_field_index
    table = table.set_column(at("time_to_goal_s"), table.schema.field("time_to_goal_s"), old)
    table = table.set_column(at("min_separation_m"), table.schema.field("min_separation_m"), alone)
    pq.write_table(table, tmp_path / "old.parquet")
    read = folder.read_episodes(tmp_path / "old.parquet")
    assert read["time_to_goal_s"].equals(run.episodes["time_to_goal_s"])
    assert read["time_to_goal_s"].null_count == 6
    assert read["min_separation_m"].null_count == read.num_rows
    assert read.equals(folder.read_episodes(tmp_path / "old.parquet"))
