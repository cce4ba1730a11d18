"""Formats of others: each read back, by its own library where that is installed."""

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from scipy.spatial.transform import Rotation

from angler_mjx.cli import main
from angler_mjx.errors import ConfigError
from angler_mjx.learning import datasets
from angler_mjx.learning.datasets.exports import flights, formats, lerobot, mpinets, parquet


@pytest.fixture(scope="module")
def data(made):
    return datasets.open(made, fields=flights.REQUIRED_FIELDS)


@pytest.fixture(scope="module")
def every(data):
    return list(flights.iterate_flights(data, "target"))


WITHOUT_UNIT = {"qw", "qx", "qy", "qz", "re", "de", "ot"}
"""Last letters of columns without a unit: quaternions, there, episode, robot."""


def silent(*_):
    pass


def written(made, tmp_path, to, **how):
    return formats.export_dataset(made, tmp_path / to, to=to, progress=silent, **how)


def test_a_flight_is_what_its_episode_holds(data, every):
    assert len(every) <= flights.count_flights(data) == 10
    for flight in every:
        episode = data.episode(flight.episode)
        steps = len(flight.time_s)
        assert episode.running[:steps, flight.robot].all()
        assert not episode.running[steps:, flight.robot].any()
        at = flights.STATE_COLUMNS.index
        recorded = {name: values[:steps, flight.robot] for name, values in episode.arrays.items()}
        np.testing.assert_array_equal(flight.state[:, at("x_m") : at("z_m") + 1], recorded["p_m"])
        np.testing.assert_array_equal(flight.state[:, at("qw") : at("qz") + 1], recorded["q"])
        np.testing.assert_array_equal(flight.action, recorded["target_m"])
        goal = flight.state[:, at("goal_x_m") : at("goal_z_m") + 1]
        assert (goal == episode.goal_m[flight.robot]).all()


def test_others_are_seen_from_the_robot(data, every):
    for flight in every:
        episode = data.episode(flight.episode)
        team = episode.running.shape[1]
        if team == 1:
            assert not flight.others.any()
            continue
        other = 1 - flight.robot
        position = episode.arrays["p_m"][: len(flight.time_s)]
        turn = [
            Rotation.from_quat(episode.arrays["q"][: len(position), i][:, [1, 2, 3, 0]])
            for i in range(2)
        ]
        moving = [turn[i].apply(episode.arrays["nu"][: len(position), i, :3]) for i in range(2)]
        assert (flight.others[:, 0, 0] == 1).all()
        np.testing.assert_allclose(
            flight.others[:, 0, 1:4], position[:, other] - position[:, flight.robot], atol=1e-5
        )
        np.testing.assert_allclose(
            flight.others[:, 0, 4:7], moving[other] - moving[flight.robot], atol=1e-4
        )


def test_parquet_holds_every_sample(made, every, tmp_path, monkeypatch):
    monkeypatch.setattr(parquet, "FLIGHTS_PER_FILE", 3)
    out = written(made, tmp_path, "parquet", action="pwm")
    table = pq.read_table(out)
    assert len(list(out.iterdir())) == -(-len(every) // 3)
    assert len(table) == sum(len(flight.time_s) for flight in every)
    rows = table.to_pylist()
    at = 0
    for flight in every:
        first = rows[at]
        assert (first["episode"], first["robot"]) == (flight.episode, flight.robot)
        assert first["split"] == flight.split
        assert first["outcome"] == flight.outcome
        last = rows[at + len(flight.time_s) - 1]
        assert last["x_m"] == flight.state[-1, 0]
        assert last["current_z_mps"] == flight.state[-1, -1]
        at += len(flight.time_s)
    assert 1100 <= rows[0]["action_pwm_0_us"] <= 1900
    about = json.loads(pq.read_schema(next(out.iterdir())).metadata[b"angler"])
    assert about["state"] == list(flights.STATE_COLUMNS)
    schema = pq.read_schema(next(out.iterdir()))
    numbers = [field for field in schema if field.name not in ("split", "outcome")]
    units = {field.name: field.metadata[b"unit"].decode() for field in numbers}
    for name, unit in units.items():
        ending = {"m": "_m", "m/s": "_mps", "rad/s": "_radps", "us": "_us", "s": "time_s"}
        assert name.endswith(ending[unit]) if unit != "1" else name[-2:] in WITHOUT_UNIT, name
    assert units["qw"] == units["other_0_there"] == "1"
    assert {about["units"][name] for name in ("x_m", "u_mps", "p_radps")} == {"m", "m/s", "rad/s"}


def test_lerobot_is_as_its_version_3_says(made, every, tmp_path, monkeypatch):
    monkeypatch.setattr(lerobot, "MAX_FRAMES", 50)
    out = written(made, tmp_path, "lerobot")
    info = json.loads((out / "meta" / "info.json").read_text())
    assert info["codebase_version"] == "v3.0"
    assert (info["fps"], info["total_episodes"]) == (5, len(every))
    rows = pq.read_table(out / "meta" / "episodes").to_pylist()
    ranges = [tuple(map(int, text.split(":"))) for text in info["splits"].values()]
    assert sorted(i for low, high in ranges for i in range(low, high)) == list(range(len(every)))
    by = {(row["split"], row["length"], row["outcome"]) for row in rows}
    assert by == {(one.split, len(one.time_s), one.outcome) for one in every}
    frames = 0
    for row in rows:
        low, high = next(r for r in ranges if r[0] <= row["episode_index"] < r[1])
        assert info["splits"][row["split"]] == f"{low}:{high}"
        position = info["data_path"].format(
            chunk_index=row["data/chunk_index"], file_index=row["data/file_index"]
        )
        table = pq.read_table(
            out / position, filters=[("episode_index", "=", row["episode_index"])]
        )
        assert row["dataset_from_index"] == frames
        assert table["index"].to_pylist() == list(range(frames, frames + row["length"]))
        assert table["timestamp"][1].as_py() == pytest.approx(1 / info["fps"])
        assert len(table["observation.state"][0]) == len(flights.STATE_COLUMNS)
        frames += row["length"]
    assert info["total_frames"] == frames
    state = np.concatenate([one.state for one in every]).astype(float)
    stats = json.loads((out / "meta" / "stats.json").read_text())["observation.state"]
    np.testing.assert_allclose(stats["mean"], state.mean(axis=0), atol=1e-6)
    np.testing.assert_allclose(stats["std"], state.std(axis=0), atol=1e-5)
    np.testing.assert_array_equal(stats["max"], state.max(axis=0))
    tasks = pytest.importorskip("pandas").read_parquet(out / "meta" / "tasks.parquet")
    assert set(tasks.index) == {one.task for one in every}


def test_pulses_of_thrusters_that_a_robot_lacks_are_neutral(data):
    episode = data.episode(0)
    fewer = {**episode.arrays, "pwm_us": episode.arrays["pwm_us"][..., :6]}
    flight = flights._build_flight(0, replace(episode, arrays=fewer), 0, 1, "pwm", 8)
    steps = len(flight.time_s)
    np.testing.assert_array_equal(flight.action[:, :6], fewer["pwm_us"][:steps, 0])
    assert (flight.action[:, 6:] == 1500.0).all()


def test_shapes_of_a_world_hold_its_rock(data):
    around = data.episode(0).environment
    found = mpinets.build_shapes(around)
    assert len(found["cuboid_centers"]) >= around["grid/occupied"].sum() > 0
    cell = float(around["grid/cell_m"])
    for centre in found["cuboid_centers"][: int(around["grid/occupied"].sum())]:
        index = np.floor((centre - around["grid/origin_m"]) / cell).astype(int)
        assert around["grid/occupied"][tuple(index)]
    number = len(found["cuboid_dims"]) + len(found["sphere_radii"]) + len(found["cylinder_radii"])
    assert number == around["grid/occupied"].sum() + around["obstacles/exists"].sum()


def test_solutions_go_from_start_to_end_evenly_in_time():
    steps = 7
    state = np.zeros((steps, 19), np.float32)
    state[:, 0] = np.linspace(0.0, 3.0, steps) ** 2
    heading = np.linspace(3.0, 3.6, steps)  # through pi
    pitch, roll = np.full((2, steps), [[0.4], [-0.7]])
    turned = Rotation.from_euler("ZYX", np.stack([heading, pitch, roll], axis=-1))
    state[:, 3:7] = turned.as_quat()[:, [3, 0, 1, 2]]
    flight = flights.ExportedFlight(
        episode=0,
        robot=0,
        outcome="reached",
        split="train",
        task="",
        time_s=np.linspace(0, 3, steps).astype(np.float32),
        state=state,
        others=np.zeros((steps, 0, 7), np.float32),
        action=np.zeros((steps, 3), np.float32),
    )
    found = mpinets.resample_flight(flight)
    assert found.shape == (mpinets.SOLUTION_POINTS, 4)
    np.testing.assert_allclose(found[[0, -1], 0], [0.0, 9.0], atol=1e-5)
    np.testing.assert_allclose(
        found[:, 3], np.linspace(3.0, 3.6, mpinets.SOLUTION_POINTS), atol=1e-5
    )


def test_hdf5_of_motion_policy_networks(made, every, tmp_path):
    h5py = pytest.importorskip("h5py", reason="h5py is not installed")
    out = written(made, tmp_path, "mpinets")
    total = 0
    for path in out.iterdir():
        with h5py.File(path) as file:
            assert file["global_solutions"].shape[1:] == (mpinets.SOLUTION_POINTS, 4)
            assert {len(file[name]) for name in file} == {len(file["global_solutions"])}
            for name, array in file.items():
                assert array.attrs["description"], name
                unit = "1" if name.endswith("quaternions") else "m"
                assert array.attrs["unit"].split(", ")[0] == unit, name
            assert file["global_solutions"].attrs["unit"] == "m, m, m, rad"
            total += len(file["global_solutions"])
    assert total == sum(flight.arrived for flight in every)


@pytest.mark.filterwarnings("ignore::UserWarning:minari")
def test_minari_reads_what_it_was_given(made, every, tmp_path, monkeypatch):
    pytest.importorskip("minari", reason="Minari is not installed")
    import minari

    monkeypatch.delenv("MINARI_DATASETS_PATH", raising=False)
    out = written(made, tmp_path, "minari")
    assert "MINARI_DATASETS_PATH" not in os.environ
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(out))
    found = minari.load_dataset("angler/made-v0")
    assert found.total_episodes == len(every)
    for episode, flight in zip(found, every, strict=True):
        np.testing.assert_array_equal(episode.observations[:, :19], flight.state)
        np.testing.assert_array_equal(episode.actions, flight.action[:-1])
        assert episode.terminations[-1] != episode.truncations[-1]
        assert episode.truncations[-1] == (flight.outcome == "timeout")


@pytest.mark.filterwarnings("ignore::UserWarning:minari")
@pytest.mark.parametrize("to", formats.FORMATS)
def test_a_relative_folder_holds_what_an_absolute_one_does(made, tmp_path, monkeypatch, to):
    if to == "minari":
        pytest.importorskip("minari", reason="Minari is not installed")
    monkeypatch.delenv("MINARI_DATASETS_PATH", raising=False)
    absolute = written(made, tmp_path, to)
    (tmp_path / "home").mkdir()
    monkeypatch.chdir(tmp_path / "home")
    relative = formats.export_dataset(made, Path("out"), to=to, progress=silent)
    assert relative == Path("out")
    files = [
        {str(file.relative_to(folder)) for file in folder.rglob("*") if file.is_file()}
        for folder in (absolute, relative)
    ]
    assert files[0] == files[1]
    assert files[0]
    assert {file.name for file in tmp_path.iterdir()} == {to, "home"}
    assert [file.name for file in Path().iterdir()] == ["out"]


@pytest.mark.parametrize(
    ("how", "message"),
    [
        ({"to": "rlds"}, "must be one of lerobot, minari, mpinets, parquet"),
        ({"to": "parquet", "action": "wish"}, "must be target or pwm"),
        ({"to": "parquet", "split": "nobody's"}, "is not among"),
    ],
)
def test_what_cannot_be_written_leaves_nothing(made, tmp_path, how, message):
    with pytest.raises(ConfigError, match=message):
        formats.export_dataset(made, tmp_path / "out", progress=silent, **how)
    assert not any(tmp_path.iterdir())


def test_the_command_writes_a_split(made, tmp_path, capsys):
    out = tmp_path / "out"
    command = ["dataset", "export", str(made), "--to", "parquet", "--split", "test_there"]
    main.main([*command, "--out", str(out)])
    assert str(out) in capsys.readouterr().out
    assert set(pq.read_table(out)["split"].to_pylist()) == {"test_there"}
