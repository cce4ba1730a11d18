"""Datasets from their files: parts, splits, and what is kept when the making is broken off."""

import json
import subprocess
from dataclasses import replace

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import zarr

from angler_mjx.cli import main
from angler_mjx.datasets import index, making, manifest, parts
from angler_mjx.datasets.config import SplitConfig
from angler_mjx.errors import ConfigError
from angler_mjx.runs import rollout, several
from angler_mjx.runs.progress import Silent
from angler_mjx.storage.folder import Run


class Told(Silent):
    def part(self, number, of, name):
        pass


def rewritten(file, name, *changes):
    text = file.read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = file.parent / name
    path.write_text(text)
    return path


def test_what_is_made_is_whole(made):
    found = manifest.read(made)
    assert found.episodes == 6
    assert [part.worlds for part in found.parts] == [4, 2]
    assert len({part.seed for part in found.parts}) == 2
    for part in found.parts:
        run = Run(made / part.path)
        assert run.summary["complete"]
        assert run.scenario.seed == part.seed
        assert run.episodes.num_rows == part.robots * part.worlds
    checked = subprocess.run(
        ["sha256sum", "--check", "--strict", "--quiet", manifest.SUMS],
        cwd=made,
        capture_output=True,
        check=False,
    )
    assert checked.returncode == 0, checked.stderr
    assert not (made / several.MAKING).exists()
    text = (made / "README.md").read_text()
    assert "- here: `variants` 3; `mass` [0.97, 1.03]; `thrust` [0.9, 1.0]" in text
    assert "test_there" in text
    assert "6 flights" in text
    assert "pip install 'zarr[cast-value-rs]" in text, "plain readers need it for arrays in steps"


def test_rows_say_what_the_runs_say(made):
    table = index.read(made)
    assert table["episode"].to_pylist() == list(range(6))
    assert set(table["split"].to_pylist()[4:]) == {"test_there"}
    for row in table.to_pylist():
        part = manifest.read(made).parts[row["part"]]
        run = Run(made / part.path)
        robots = [r for r in run.episodes.to_pylist() if r["world"] == row["world"]]
        assert row["reached"] == sum(r["outcome"] == "reached" for r in robots)
        assert row["planned"] == sum(r["planned"] for r in robots)
        ends = [r["time_to_goal_s"] or r["failure_time_s"] for r in robots]
        assert row["duration_s"] == pytest.approx(max(ends))
        # Every robot that still runs does so in the first `samples` samples.
        outcome = np.asarray(run.trajectories["outcome"][row["world"]])
        assert (outcome[row["samples"] :] != 0).all()
        group = run.trajectories["environment"]
        lines = np.asarray(group["line_free"][row["world"]])
        assert row["free_lines"] == lines.sum()


def test_rows_count_robots_that_arrived_and_until_when(copy):
    """Of three kinds of ends, in a part whose robots all ran out of time."""
    part = manifest.read(copy).parts[0]
    run = copy / part.path
    rows = Run(run).episodes.to_pylist()
    for at, outcome, name, time_s in (
        (0, "reached", "time_to_goal_s", 1.25),
        (1, "reached", "time_to_goal_s", 2.7),
        (2, "collision_static", "failure_time_s", 0.05),
        (3, "reached", "time_to_goal_s", 0.2),
    ):
        rows[at] |= {"outcome": outcome, "time_to_goal_s": None, "failure_time_s": None}
        rows[at] |= {name: time_s}
    schema = pq.read_schema(run / "episodes.parquet")
    pq.write_table(pa.Table.from_pylist(rows, schema=schema), run / "episodes.parquet")
    entry = {"scene": "here", "expert": "grid", "split": None}
    found = index.rows(run, 0, entry, SplitConfig(), 0).to_pylist()
    assert [row["reached"] for row in found] == [2, 1, 0, 0]
    assert [row["success"] for row in found] == [True, False, False, False]
    # Samples at 5 Hz from t = 0: those before the end, and at least one.
    assert [row["samples"] for row in found] == [14, 1, 20, 20]
    assert found[0]["duration_s"] == pytest.approx(2.7)


def test_a_tile_is_as_large_as_memory_is_to_hold(file):
    """Arrays of a world in float32, counted one by one, and no other number of worlds fits."""
    config, table = parts.read(file)
    part = parts.parts(config, table, 6, "file")[0]
    assert making.tile_of(part) == 2  # of the file
    scenario = part.scenario
    time = scenario.time.model_copy(update={"horizon_s": 3600.0, "record_hz": 20.0})
    flown = scenario.model_copy(update={"tile": None, "worlds": 10**6, "time": time})
    tile = making.tile_of(replace(part, scenario=flown))
    samples, robots, obstacles = 3600 * 20, 2, 2
    # p, q, nu, target, current, pwm of 8, for each robot; p and q of each obstacle.
    least = 4 * samples * (robots * (3 + 4 + 6 + 3 + 3 + 8) + obstacles * 7)
    assert tile & (tile - 1) == 0
    assert tile * least <= 2e9 <= 4 * tile * least


def test_an_environment_is_in_one_split_whatever_dataset_it_is_in():
    shares = SplitConfig(train=0.6, val=0.3, test=0.1)
    rng = np.random.default_rng(0)
    rocks = rng.random((3000, 3, 3, 2)) < 0.4
    digests = [index.environment_hash(rock, b"") for rock in rocks]
    splits = np.array([index.split_of(digest, shares) for digest in digests])
    for name, share in (("train", 0.6), ("val", 0.3), ("test", 0.1)):
        # Four standard deviations of a binomial.
        assert abs((splits == name).mean() - share) < 4 * np.sqrt(share * (1 - share) / 3000)
    # The rock decides, whoever flies in it; of empty water all that was drawn.
    assert index.environment_hash(rocks[0], b"a") == index.environment_hash(rocks[0], b"b")
    empty = np.zeros((3, 3, 2), bool)
    assert index.environment_hash(empty, b"a") != index.environment_hash(empty, b"b")
    assert index.environment_hash(rocks[0], b"") != index.environment_hash(rocks[0].ravel(), b"")


def test_distances_of_lines_are_those_of_a_fine_search():
    rng = np.random.default_rng(1)
    p, q, r, s = rng.normal(size=(4, 40, 3))
    q[0], s[1], s[2] = p[0], r[1], r[2] + (q[2] - p[2])  # a point, another, and parallel lines
    along = np.linspace(0.0, 1.0, 400)
    for i in range(40):
        a = p[i] + along[:, None] * (q[i] - p[i])
        b = r[i] + along[:, None] * (s[i] - r[i])
        least = np.linalg.norm(a[:, None] - b[None], axis=-1).min()
        found = index.segment_gap_m(p[i : i + 1], q[i : i + 1], r[i : i + 1], s[i : i + 1])[0]
        assert found <= least + 1e-9
        assert found >= least - 0.02


def test_shares_are_kept_to_one_episode(file):
    config, table = parts.read(
        rewritten(
            file,
            "weights.toml",
            ("weight = 2.0", "weight = 2.0\nteams = [1, 2, 4]"),
            ('name = "grid"', 'name = "grid"\nweight = 3.0\n\n[[expert]]\nname = "priority"'),
        )
    )
    found = parts.parts(config, table, 1000, "file")
    assert sum(part.scenario.worlds for part in found) == 1000
    for part in found:
        share = (2 / 3 / 3 if part.scene == "here" else 1 / 3) * (
            0.75 if part.expert == "grid" else 0.25
        )
        assert abs(part.scenario.worlds - 1000 * share) <= 1
        assert len(part.scenario.members()) == part.robots
        assert part.scenario.planner.name == part.expert
    assert {part.robots for part in found if part.scene == "here"} == {1, 2, 4}


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ((("weight = 2.0", "weight = -1.0"),), "weight"),
        ((('name = "there"', 'name = "here"'),), "is there twice"),
        ((("train = 0.5", "train = 0.7"),), "must be 1"),
        ((('name = "grid"', 'name = "nobody"'),), "nobody"),
        ((("shifted = true", "set = { seed = 3 }"),), "give seed instead"),
        ((("shifted = true", "set = { time = { record_hz = 1.0 } }"),), "recorded in one way"),
    ],
)
def test_what_cannot_be_made_is_refused(file, tmp_path, changes, said):
    path = rewritten(file, "faulty.toml", *changes)
    with pytest.raises(ConfigError, match=said):
        making.make(making.ask(path, 6), tmp_path / "out", told=Told())
    assert not any(tmp_path.iterdir())


def test_too_few_episodes_say_how_many_would_do(file, tmp_path):
    with pytest.raises(ConfigError, match=r"--episodes 1: .* give 2 or more"):
        making.make(making.ask(file, 1), tmp_path / "out", told=Told())


def test_a_broken_off_making_goes_on_to_the_same_bytes(file, made, tmp_path, monkeypatch):
    flown, out = [], tmp_path / "out"
    whole = rollout.rollout

    def broken(scenario, **how):
        flown.append(scenario.seed)
        if len(flown) == 2:
            raise KeyboardInterrupt
        return whole(scenario, **how)

    monkeypatch.setattr(rollout, "rollout", broken)
    with pytest.raises(KeyboardInterrupt):
        making.make(making.ask(file, 6), out, told=Told())
    with pytest.raises(ConfigError, match="--resume"):
        making.make(making.ask(file, 6), out, told=Told())
    with pytest.raises(ConfigError, match="other episodes"):
        making.make(making.ask(file, 5), out, told=Told(), resume=True)
    monkeypatch.setattr(rollout, "rollout", whole)
    assert making.make(making.ask(file, 6), out, told=Told(), resume=True) == out
    with pytest.raises(ConfigError, match="complete"):
        making.make(making.ask(file, 6), out, told=Told(), resume=True)
    data = [p.relative_to(made) for p in made.rglob("trajectories.zarr/**/*") if p.is_file()]
    assert data
    for name in data:
        assert (out / name).read_bytes() == (made / name).read_bytes()
    assert index.read(out).equals(index.read(made))


def test_show_and_stray_folders(made, tmp_path, capsys):
    main.main(["dataset", "show", str(made)])
    assert "test_there: 2" in capsys.readouterr().out
    with pytest.raises(SystemExit):
        main.main(["dataset", "show", str(tmp_path)])
    assert "not a dataset" in capsys.readouterr().err


def test_manifests_are_not_believed(copy):
    path = copy / manifest.MANIFEST
    table = json.loads(path.read_text())
    for change, said in (
        ({"schema_version": 7}, "schema_version = 7"),
        ({"parts": [{**table["parts"][0], "path": "../elsewhere"}]}, "leaves the dataset's folder"),
        ({"parts": [{**table["parts"][0], "path": "/etc"}]}, "leaves the dataset's folder"),
        ({"episodes": 0}, "episodes"),
    ):
        path.write_text(json.dumps({**table, **change}))
        with pytest.raises(ConfigError, match=said):
            manifest.read(copy)
    path.write_text("{")
    with pytest.raises(ConfigError, match="not valid JSON"):
        manifest.read(copy)
    pq.write_table(pa.table({"a": [1]}), copy / manifest.INDEX)
    with pytest.raises(ConfigError, match="holds the columns a"):
        index.read(copy)
    for first in ("a", "z"):
        names = [first, *index.SCHEMA.names[1:]]
        table = index.SCHEMA.empty_table().rename_columns(names)
        pq.write_table(table, copy / manifest.INDEX)
        with pytest.raises(ConfigError, match=f"holds the columns {first}, part"):
            index.read(copy)


def test_samples_are_stored_in_the_steps_that_the_manifest_tells(made):
    found = manifest.read(made)
    assert found.arrays["p_m"].step == 1e-3
    assert found.arrays["q"].step is None
    stored = zarr.open_group(made / found.parts[0].path / "trajectories.zarr", mode="r")
    places = np.asarray(stored["p_m"][:], float)
    steps = places[np.isfinite(places)] / 1e-3
    assert np.abs(steps - np.round(steps)).max() < 0.01
