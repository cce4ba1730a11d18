"""Exports to LeRobot held to what LeRobot 0.6.1's own writer wrote, and edited by its tools.

``lerobot_writer.json`` was recorded from that writer: columns and types of its files, the frames of
two episodes, and their statistics.
"""

import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from angler_mjx.learning.datasets.exports import formats, lerobot

RECORDED = json.loads((Path(__file__).parent / "lerobot_writer.json").read_text())

BIN = 1 / 5000
"""Width of a bin of the histogram from which LeRobot reads quantiles, relative to the range."""


@pytest.fixture(scope="module")
def exported(made, tmp_path_factory):
    out = tmp_path_factory.mktemp("lerobot") / "out"
    return formats.export_dataset(made, out, to="lerobot", progress=lambda *_: None)


def of_recorded(feature, episode):
    """Statistics of one feature of a recorded episode, as LeRobot wrote them."""
    row = RECORDED["statistics"][episode]
    return {name: np.array(row[f"stats/{feature}/{name}"]) for name in lerobot.STATISTIC_NAMES}


def columns(path):
    """Columns of a Parquet file and their types, as text."""
    schema = pq.read_schema(path)
    return {name: str(kind) for name, kind in zip(schema.names, schema.types, strict=True)}


def as_ours(recorded, features):
    """Recorded columns, with those of its features of one and two numbers for each of ours.

    A feature of one number is a plain column; one of several is a list of fixed size.
    """
    feature_names = ("observation.state", "action")
    expected = {
        n: kind for n, kind in recorded.items() if not any(one in n for one in feature_names)
    }
    for feature, width in features.items():
        like = feature_names[width == 1]
        expected |= {
            name.replace(like, feature): kind.replace("[2]", f"[{width}]")
            for name, kind in recorded.items()
            if like in name
        }
    return expected


def test_files_have_the_columns_and_types_of_lerobots_writer(exported):
    info = json.loads((exported / "meta" / "info.json").read_text())
    assert sorted(info) == RECORDED["info"]
    features = {
        name: feature["shape"][0]
        for name, feature in info["features"].items()
        if name.startswith(("observation", "action"))
    }
    data = columns(next((exported / "data").rglob("*.parquet")))
    assert data == as_ours(RECORDED["data"], features)
    episodes = columns(next((exported / "meta" / "episodes").rglob("*.parquet")))
    for ours in ("outcome", "split"):
        assert episodes.pop(ours) == "string"
    assert episodes == as_ours(RECORDED["episodes"], dict.fromkeys(features, 0))


@pytest.mark.parametrize("feature", ["observation.state", "action"])
def test_statistics_are_those_of_lerobots_writer(feature):
    ours = [
        lerobot.compute_statistics(np.array(frames[feature], np.float32))
        for frames in RECORDED["frames"]
    ]
    theirs = [of_recorded(feature, episode) for episode in range(2)]
    ours.append(lerobot.aggregate_statistics(ours))
    theirs.append({name: np.array(x) for name, x in RECORDED["aggregated"][feature].items()})
    for written, recorded in zip(ours, theirs, strict=True):
        assert written.keys() == recorded.keys()
        width = recorded["max"] - recorded["min"]
        for name, values in written.items():
            tolerance = 1.01 * BIN if name in lerobot.QUANTILES else 1e-6
            assert (np.abs(values - recorded[name]) <= tolerance * width).all(), name


def test_an_episode_of_one_sample_has_no_spread():
    found = lerobot.compute_statistics(np.array([[3.0, -1.0]], np.float32))
    assert found["count"].tolist() == [1]
    assert found["std"].tolist() == [0.0, 0.0]
    for name in ("min", "max", "mean", *lerobot.QUANTILES):
        assert found[name].tolist() == [3.0, -1.0]


def test_every_episode_has_the_statistics_of_its_own_samples(made, tmp_path, monkeypatch):
    monkeypatch.setattr(lerobot, "EPISODES_PER_FILE", 4)
    monkeypatch.setattr(lerobot, "ROW_GROUP_SIZE", 3)
    out = formats.export_dataset(
        made, tmp_path / "out", to="lerobot", action="pwm", progress=lambda *_: None
    )
    data = pq.read_table(out / "data")
    episodes = pq.read_table(out / "meta" / "episodes").to_pylist()
    files = sorted((out / "meta" / "episodes").rglob("*.parquet"))
    lengths = [pq.read_metadata(path).num_rows for path in files]
    assert lengths[:-1] == [4] * (len(files) - 1)
    assert [row["episode_index"] for row in episodes] == list(range(len(episodes)))
    for row in episodes:
        assert row["meta/episodes/file_index"] == row["episode_index"] // 4
        rows = data.slice(row["dataset_from_index"], row["length"])
        for feature in ("observation.state", "action", "timestamp", "index"):
            values = np.array(rows[feature].to_pylist(), float).reshape(row["length"], -1)
            of = {name: row[f"stats/{feature}/{name}"] for name in lerobot.STATISTIC_NAMES}
            assert of["count"] == [row["length"]]
            np.testing.assert_array_equal(of["min"], values.min(axis=0))
            np.testing.assert_array_equal(of["max"], values.max(axis=0))
            np.testing.assert_allclose(of["mean"], values.mean(axis=0), atol=1e-9)
            np.testing.assert_allclose(of["std"], values.std(axis=0), atol=1e-9)
            below = (values <= of["q90"]).mean(axis=0)
            assert (below >= 0.9 - 1e-9).all()
            assert ((values < of["q90"]).mean(axis=0) < 0.9).all()


@pytest.mark.nightly(
    by="tests/angler_mjx/learning/datasets/test_lerobot.py::test_statistics_are_those_of_lerobots_writer"
)
def test_lerobots_own_tools_keep_statistics(exported, tmp_path):
    """Delete, split and merge: what policies normalise by is that of the episodes that are left."""
    tools = pytest.importorskip(
        "lerobot.datasets.dataset_tools", reason="lerobot is not installed", exc_type=ImportError
    )
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    whole = LeRobotDataset("angler/export", root=exported)
    state = np.array(pq.read_table(exported / "data")["observation.state"].to_pylist(), float)
    number = np.array(pq.read_table(exported / "data")["episode_index"])

    def assert_statistics(data, samples):
        found = data.meta.stats["observation.state"]
        np.testing.assert_allclose(found["mean"], samples.mean(axis=0), atol=1e-6)
        np.testing.assert_allclose(found["std"], samples.std(axis=0), atol=1e-6)
        np.testing.assert_array_equal(found["max"], samples.max(axis=0))

    assert_statistics(whole, state)
    fewer = tools.delete_episodes(whole, [0, 2], output_dir=tmp_path / "a", repo_id="angler/a")
    assert_statistics(fewer, state[~np.isin(number, [0, 2])])
    parts = tools.split_dataset(whole, {"a": [0, 1], "b": [2, 3, 4]}, output_dir=tmp_path / "parts")
    assert_statistics(parts["a"], state[number < 2])
    both = tools.merge_datasets(
        [parts["b"], parts["a"]], output_repo_id="angler/both", output_dir=tmp_path / "both"
    )
    assert_statistics(both, state[number < 5])
