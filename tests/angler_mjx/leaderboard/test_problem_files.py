"""Files of the frozen problems, read without the package."""

import hashlib
import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
import zarr
from scipy.interpolate import RegularGridInterpolator

from angler_mjx.errors import ConfigError, RunError
from angler_mjx.leaderboard import problem_files, problem_sets
from angler_mjx.planning.planner import PathShape
from angler_mjx.progress import Progress
from angler_mjx.runs.simulator.simulator import Simulator


def raw(group, name, world, dtype):
    """Return an array of a problem from its file of plain numbers."""
    metadata = json.loads((group / name / "zarr.json").read_text())
    chunk = group / name / "c" / str(world)
    for _ in metadata["shape"][1:]:
        chunk /= "0"
    return np.frombuffer(chunk.read_bytes(), dtype).reshape(metadata["shape"][1:])


def test_every_set_is_frozen(manifest, sets):
    assert [record.name for record in manifest.sets] == list(sets)
    assert manifest.problems == 300
    assert all(len(set(record.sha256)) == len(record.sha256) for record in manifest.sets)
    assert all(len(record.sha256) == sets[record.name].problems for record in manifest.sets)


def test_scenarios_of_all_sets_still_have_the_frozen_digests(benchmark, manifest, sets):
    """A change of vehicles, worlds or draws makes another benchmark: see the page's versions."""
    for record in manifest.sets:
        scenario = problem_files.build_set_scenario(
            benchmark, sets[record.name], record.attempt, b""
        )
        assert scenario.digest() == record.digest, record.name


def test_hashes_are_those_of_rock_starts_and_goals_in_the_files(problems, manifest):
    for record in problem_files.read_manifest(problems / "manifest.json").sets:
        group = problems / f"{record.name}.zarr"
        for world, expected in enumerate(record.sha256):
            digest = hashlib.sha256(raw(group, "grid/occupied", world, "u1").tobytes())
            for name in ("team/start_m", "team/goal_m"):
                digest.update(raw(group, name, world, "<f4").tobytes())
            assert digest.hexdigest() == expected
        assert manifest.find(record.name) == record


def test_a_bound_is_the_longest_straight_line_at_cruise_speed(problems, manifest):
    for record in problem_files.read_manifest(problems / "manifest.json").sets:
        group = problems / f"{record.name}.zarr"
        for world, bound_s in enumerate(record.bound_s):
            start, goal = (raw(group, f"team/{n}_m", world, "<f4") for n in ("start", "goal"))
            assert bound_s == pytest.approx(
                2.0 * np.linalg.norm(goal - start, axis=1).max(), abs=1e-3
            )
            assert 20.0 < bound_s < 240.0


def test_files_name_their_problems_and_the_limit(problems, sets):
    attributes = json.loads((problems / "open-ocean-known-01.zarr" / "zarr.json").read_text())
    table = attributes["attributes"]
    assert table["problems"] == ["open-ocean-known-01/0", "open-ocean-known-01/1"]
    assert (table["benchmark"], table["deadline_s"], table["max_points"]) == (
        "ANGLER-1 1.0",
        1.0,
        64,
    )
    assert table["information"] == {"obstacles": "truth", "current": "truth"}


def test_the_lattice_of_a_known_current_interpolates_to_it(problems, benchmark, manifest, sets):
    name = "open-ocean-known-01"
    group, record = problems / f"{name}.zarr", manifest.find(name)
    scenario = problem_files.build_set_scenario(benchmark, sets[name], record.attempt, b"")
    simulator = Simulator(scenario, devices=1, paths=PathShape(points=2))
    axes = [
        np.frombuffer((group / "current_lattice" / axis / "c" / "0").read_bytes(), "<f4")
        for axis in ("time_s", "x_m", "y_m", "z_m")
    ]
    rng = np.random.default_rng(0)
    for world, problem in enumerate(simulator.problems(0, 2)):
        lattice = raw(group, "current_lattice/velocity_mps", world, "<f4")
        assert np.abs(lattice[..., :2]).max() > 0.01
        look_up = RegularGridInterpolator(axes, lattice)
        times = rng.uniform(axes[0][0], axes[0][-1], 50)
        points = [rng.uniform(axis[0], axis[-1], 50) for axis in axes[1:]]
        for row in np.stack([times, *points], axis=-1):
            velocity = problem.current.velocity(row[1:].astype("f4"), np.float32(row[0]))
            np.testing.assert_allclose(look_up(row)[0], velocity, atol=2e-3)
    simulator.close()


def test_problems_that_differ_from_the_frozen_ones_are_refused(tmp_path, benchmark, manifest, sets):
    name = "open-still-known-01"
    record = manifest.find(name)
    other = replace(record, sha256=("0" * 64, record.sha256[1]))
    frozen = replace(manifest, sets=(other,))
    with pytest.raises(RunError, match=f"{name}: its problems differ from the frozen ones"):
        problem_files.write_problem_files(
            benchmark, [sets[name]], tmp_path / "p", Progress(), frozen=frozen
        )
    assert not list((tmp_path / "p").iterdir())


def test_a_set_without_its_line_in_the_manifest_is_written_again(
    tmp_path, benchmark, manifest, sets, problems
):
    """A call was ended between the two. Nothing else is written over."""
    name = "open-still-known-01"
    out, arguments = tmp_path / "p", (benchmark, [sets[name]], tmp_path / "p", Progress())
    shutil.copytree(problems / f"{name}.zarr", out / f"{name}.zarr")
    (out / f"{name}.zarr" / "floor_z_m" / "zarr.json").unlink()
    made = problem_files.write_problem_files(*arguments, frozen=manifest)
    assert made.find(name) == manifest.find(name)
    written, expected = (
        {p.relative_to(folder): p.read_bytes() for p in folder.rglob("*") if p.is_file()}
        for folder in (out / f"{name}.zarr", problems / f"{name}.zarr")
    )
    assert written == expected
    (out / "manifest.json").unlink()
    shutil.rmtree(out / f"{name}.zarr")
    zarr.open_group(out / f"{name}.zarr", mode="w").attrs["schema"] = "angler_mjx plans"
    with pytest.raises(ConfigError, match="exists"):
        problem_files.write_problem_files(*arguments, frozen=manifest)
    assert zarr.open_group(out / f"{name}.zarr", mode="r").attrs["schema"] == "angler_mjx plans"


def test_sets_of_another_version_are_refused_where_they_are_kept(
    tmp_path, benchmark, manifest, sets, problems
):
    shutil.copytree(problems, tmp_path / "p")
    path = tmp_path / "p" / "manifest.json"
    table = json.loads(path.read_text())
    table["sets"][0]["digest"] = "0" * 64
    path.write_text(json.dumps(table))
    entry = sets[table["sets"][0]["name"]]
    with pytest.raises(RunError, match="differ from the frozen ones"):
        problem_files.write_problem_files(
            benchmark, [entry], tmp_path / "p", Progress(), frozen=manifest
        )


def test_hidden_problems_differ_and_name_no_seed(tmp_path, benchmark, manifest, sets):
    name, secret = "open-still-known-01", b"0123456789abcdef"
    hidden = problem_files.write_problem_files(
        benchmark, [sets[name]], tmp_path / "p", Progress(), secret=secret
    )
    assert hidden.secret == hashlib.sha256(secret).hexdigest()
    assert not set(hidden.find(name).sha256) & set(manifest.find(name).sha256)
    group = tmp_path / "p" / f"{name}.zarr"
    seed = problem_sets.derive_seed(benchmark, name, secret, hidden.find(name).attempt)
    text = (group / "zarr.json").read_text()
    assert json.loads(text)["attributes"]["seed"] == 0
    assert str(seed) not in text
    assert raw(group, "seed", 0, "<u4") == 0
    with pytest.raises(ConfigError, match="another secret"):
        problem_files.write_problem_files(benchmark, [sets[name]], tmp_path / "p", Progress())


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda table: table.update(benchmark="ANGLER-0"), "is of 'ANGLER-0'"),
        (lambda table: table["sets"][0].pop("sha256"), "is no manifest"),
        (lambda table: table["sets"][0].update(attempt="many"), "is no manifest"),
    ],
)
def test_a_manifest_that_cannot_be_read_is_refused(problems, tmp_path, change, message):
    table = json.loads((problems / "manifest.json").read_text())
    change(table)
    (tmp_path / "manifest.json").write_text(json.dumps(table))
    with pytest.raises(ConfigError, match=message):
        problem_files.read_manifest(tmp_path / "manifest.json")
