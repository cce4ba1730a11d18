"""Rows of the index against episodes, splits by environment, and distances of segments."""

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.learning.datasets import index, manifest
from angler_mjx.learning.datasets.config import SplitConfig
from angler_mjx.runs.storage.folder import Run


def test_rows_agree_with_episodes_and_trajectories(made):
    table = index.read_index(made)
    assert table["episode"].to_pylist() == list(range(6))
    assert set(table["split"].to_pylist()[4:]) == {"test_there"}
    for row in table.to_pylist():
        part = manifest.read_manifest(made).parts[row["part"]]
        run = Run(made / part.path)
        robots = [r for r in run.episodes.to_pylist() if r["world"] == row["world"]]
        assert row["reached"] == sum(r["outcome"] == "reached" for r in robots)
        assert row["planned"] == sum(r["planned"] for r in robots)
        ends = [r["time_to_goal_s"] or r["failure_time_s"] for r in robots]
        assert row["duration_s"] == pytest.approx(max(ends))
        # A robot that is still on its way is so in the first `samples` samples.
        outcome = np.asarray(run.trajectories["outcome"][row["world"]])
        assert (outcome[row["samples"] :] != 0).all()
        group = run.trajectories["environment"]
        lines = np.asarray(group["line_free"][row["world"]])
        assert row["free_lines"] == lines.sum()


def test_rows_count_arrivals_and_samples_until_the_last_end(copy):
    """Three kinds of ends, in a part whose robots all ran out of time."""
    part = manifest.read_manifest(copy).parts[0]
    run = copy / part.path
    rows = Run(run).episodes.to_pylist()
    for i, outcome, name, time_s in (
        (0, "reached", "time_to_goal_s", 1.25),
        (1, "reached", "time_to_goal_s", 2.7),
        (2, "collision_static", "failure_time_s", 0.05),
        (3, "reached", "time_to_goal_s", 0.2),
    ):
        rows[i] |= {"outcome": outcome, "time_to_goal_s": None, "failure_time_s": None}
        rows[i] |= {name: time_s}
    schema = pq.read_schema(run / "episodes.parquet")
    pq.write_table(pa.Table.from_pylist(rows, schema=schema), run / "episodes.parquet")
    entry = {"scene": "here", "expert": "grid", "split": None}
    counted = index.build_rows(run, 0, entry, SplitConfig(), 0).to_pylist()
    assert [row["reached"] for row in counted] == [2, 1, 0, 0]
    assert [row["success"] for row in counted] == [True, False, False, False]
    # Samples at 5 Hz from t = 0: those before the end, and at least one.
    assert [row["samples"] for row in counted] == [14, 1, 20, 20]
    assert counted[0]["duration_s"] == pytest.approx(2.7)


@pytest.mark.parametrize("first", ["a", "z"])
def test_other_columns_are_refused(tmp_path, first):
    """Names that sort before and after those of an index."""
    table = index.SCHEMA.empty_table().rename_columns([first, *index.SCHEMA.names[1:]])
    pq.write_table(table, tmp_path / manifest.INDEX)
    with pytest.raises(ConfigError, match=f"holds the columns {first}, part"):
        index.read_index(tmp_path)


def test_an_environment_is_in_one_split_of_every_dataset():
    fractions = SplitConfig(train=0.6, val=0.3, test=0.1)
    rng = np.random.default_rng(0)
    rocks = rng.random((3000, 3, 3, 2)) < 0.4
    digests = [index.hash_environment(rock, b"") for rock in rocks]
    splits = np.array([index.assign_split(digest, fractions) for digest in digests])
    for name, fraction in (("train", 0.6), ("val", 0.3), ("test", 0.1)):
        # Four standard deviations of a binomial.
        deviation = np.sqrt(fraction * (1 - fraction) / 3000)
        assert abs((splits == name).mean() - fraction) < 4 * deviation
    # The rock decides, whichever team moves in it; without rock, all that was sampled.
    assert index.hash_environment(rocks[0], b"a") == index.hash_environment(rocks[0], b"b")
    empty = np.zeros((3, 3, 2), bool)
    assert index.hash_environment(empty, b"a") != index.hash_environment(empty, b"b")
    assert index.hash_environment(rocks[0], b"") != index.hash_environment(rocks[0].ravel(), b"")


def test_distances_of_segments_are_those_of_a_fine_search():
    rng = np.random.default_rng(1)
    p, q, r, s = rng.normal(size=(4, 40, 3))
    q[0], s[1], s[2] = p[0], r[1], r[2] + (q[2] - p[2])  # a point, another, and parallel lines
    along = np.linspace(0.0, 1.0, 400)
    for i in range(40):
        a = p[i] + along[:, None] * (q[i] - p[i])
        b = r[i] + along[:, None] * (s[i] - r[i])
        searched_m = np.linalg.norm(a[:, None] - b[None], axis=-1).min()
        gap_m = index.segment_gap_m(p[i : i + 1], q[i : i + 1], r[i : i + 1], s[i : i + 1])[0]
        assert gap_m <= searched_m + 1e-9
        assert gap_m >= searched_m - 0.02
