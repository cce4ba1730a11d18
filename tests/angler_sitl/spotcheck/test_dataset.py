"""Spot checks of datasets: who is drawn, what it comes to, and that the dataset stays whole.

The dataset is made by hand, and what its parts' flights would have been is what they recorded, so
far aside.
"""

import importlib.util
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.figure import Figure

from angler_mjx.errors import ConfigError, RunError
from angler_mjx.learning.datasets import (
    card,
    checksums,
    figures,
    gaps,
    index,
    manifest,
    manifest_building,
)
from angler_mjx.learning.datasets.config import DatasetConfig, DatasetScene, Expert
from angler_mjx.learning.datasets.maintenance import repair
from angler_mjx.learning.datasets.verifying import integrity
from angler_mjx.progress import Progress
from angler_sitl.spotcheck import dataset, flight, runner, world_selection
from angler_sitl.spotcheck.results import SpotcheckResult, SpotcheckSettings

ASIDE_M = {"000_near": 0.1, "001_far": 0.5}
"""How far real autopilots are from what each part recorded."""


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Two parts of two worlds of four robots, without figures; not to be changed."""
    path = Path(__file__).parents[2] / "angler_mjx" / "report" / "conftest.py"
    spec = importlib.util.spec_from_file_location("runs_by_hand", path)
    made = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(made)
    place = tmp_path_factory.mktemp("datasets") / "small"
    (place / "runs").mkdir(parents=True)
    parts = []
    for number, name in enumerate(ASIDE_M):
        made.make_run(
            place / "runs" / name, [made.make_scene(2 * number), made.make_scene(2 * number + 1)], 2
        )
        parts.append(
            SimpleNamespace(path=f"runs/{name}", scene=name, expert="grid", robots=4, split=None)
        )
    config = DatasetConfig(
        name="small",
        scenario="reef_fleet",
        scene=(DatasetScene(name="near"),),
        expert=(Expert(name="grid"),),
    )
    found = manifest_building.build_manifest(config, parts, place)
    table = index.build_index(place, found)
    found = manifest_building.add_counts(found, table)
    index.write_index(place, table)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(figures, "plot_figures", lambda *_: None)
        card.write_card(place, found, table)
    manifest.write_manifest(
        place, found.model_copy(update={"sums": checksums.write_checksums(place)})
    )
    return place


@pytest.fixture
def place(whole, tmp_path):
    return shutil.copytree(whole, tmp_path / "small")


@pytest.fixture
def asked(monkeypatch):
    """Puts in flights; a list of what the parts were asked for, and whether each goes through."""
    seen = []
    goes = {"001_far": True}

    def plan(run_path, settings):
        run = runner.Run(run_path)
        picks = world_selection.pick_worlds(run.episodes, settings.episodes, seed=settings.seed)
        return SpotcheckResult(
            run=run,
            settings=settings,
            picks=picks,
            counts=(4,),
            likeness={},
            autopilot="stand-in",
            provenance={"command": "angler spotcheck"},
        )

    def flown(run_path, settings, out):
        found = plan(run_path, settings)
        flights = {}
        for pick in found.picks:
            known = flight.load_recorded(found.run, pick.world, 4)
            aside = np.array([0.0, 0.0, ASIDE_M[run_path.name]])
            flights[pick.world, "recorded", 4] = known
            flights[pick.world, "guided", 4] = replace(known, p_m=known.p_m + aside)
        return replace(found, flights=flights, complete=True)

    def check(run_path, settings, out, progress, *, resume=False):
        seen.append((run_path.name, settings.episodes, resume))
        (out / "flights").mkdir(parents=True, exist_ok=True)
        through = goes.get(run_path.name, True)
        dataset.folder.save_table(out, {"asked": {}, "complete": through, "picks": []})
        return replace(flown(run_path, settings, out), complete=through)

    monkeypatch.setattr(runner, "plan_spot_check", plan)
    monkeypatch.setattr(runner, "run_spot_check", check)
    monkeypatch.setattr(runner, "load_result", flown)
    return SimpleNamespace(seen=seen, goes=goes)


SETTINGS = SpotcheckSettings(episodes=3, against=(), levels=("guided",))


def files(place):
    return integrity.check_files(place, manifest.read_manifest(place), Progress()).findings


def test_episodes_are_shared_out_to_all_parts():
    assert dataset.allocate_episodes([100, 50, 1], 3, 0) == [1, 1, 1]
    assert dataset.allocate_episodes([100, 50, 1], 151, 0) == [100, 50, 1]
    assert dataset.allocate_episodes([90, 30], 42, 0) == [31, 11]  # 1 each, 40 by 89 and 29
    few = {tuple(dataset.allocate_episodes([9] * 6, 2, seed)) for seed in range(20)}
    assert len(few) > 5
    assert all(sum(one) == 2 and max(one) == 1 for one in few)
    rng = np.random.default_rng(0)
    for _ in range(200):
        worlds = rng.integers(1, 40, rng.integers(1, 9)).tolist()
        count = int(rng.integers(1, sum(worlds) + 1))
        counts = dataset.allocate_episodes(worlds, count, 1)
        assert sum(counts) == count
        assert all(0 <= n <= w for n, w in zip(counts, worlds, strict=True))


def test_the_gap_is_written_into_the_dataset_which_stays_whole(place, asked, tmp_path):
    before = checksums.read_checksums(place, manifest.read_manifest(place).sums)
    found = dataset.check_dataset(place, SETTINGS, tmp_path / "check", None)
    assert sum(episodes for _, episodes, _ in asked.seen) == 3
    assert gaps.read_spot_check(place) == found
    (row,) = found.rows
    assert (row.flown_by, row.against, row.robots, row.agree) == ("guided", "recorded", 12, 12)
    # 8 robots of one part and 4 of the other, or the other way round: the median is one of both.
    assert row.track_rms_m[0] in (pytest.approx(0.1, rel=1e-5), pytest.approx(0.5, rel=1e-5))
    assert row.track_rms_m[1] == pytest.approx(0.5, rel=1e-5)
    assert row.arrival_s == (0.0, 0.0)
    text = (place / card.README).read_text()
    assert "| guided | recorded | 12 of 12" in text
    assert "sampled more often" in text
    assert files(place) == []
    after = checksums.read_checksums(place, manifest.read_manifest(place).sums)
    assert {name for name in after if after[name] != before.get(name)} == {
        gaps.SPOT_CHECK_FILE,
        card.README,
    }
    # Written once more it is the same card.
    card.write_readme(place, manifest.read_manifest(place), index.read_index(place))
    assert (place / card.README).read_text() == text


def test_damage_is_not_hidden_by_a_spot_check(place, asked, tmp_path):
    shards = (place / "runs" / "000_near" / "trajectories.zarr" / "q").rglob("c/**/0")
    shard = next(path for path in shards if path.is_file())
    shard.write_bytes(shard.read_bytes() + b"x")
    dataset.check_dataset(place, SETTINGS, tmp_path / "check", None)
    assert [one.where for one in files(place)] == [shard.relative_to(place).as_posix()]


def test_what_was_interrupted_leaves_the_dataset_and_goes_on(place, asked, tmp_path):
    asked.goes["001_far"] = False
    out = tmp_path / "check"
    assert dataset.check_dataset(place, SETTINGS, out, None) is None
    assert gaps.read_spot_check(place) is None
    assert files(place) == []
    with pytest.raises(ConfigError, match="--resume"):
        dataset.check_dataset(place, SETTINGS, out, None)
    asked.goes["001_far"] = True
    asked.seen.clear()
    assert dataset.check_dataset(place, SETTINGS, out, None, resume=True) is not None
    # The first part is whole already.
    assert [(name, resume) for name, _, resume in asked.seen] == [("001_far", True)]


@pytest.mark.parametrize(
    ("episodes", "out", "said"),
    [
        (5, "check", "--episodes 5: the dataset has 4"),
        (0, "check", "--episodes 0: give 1 or more"),
        (3, "small/check", "lies in the dataset"),
    ],
)
def test_what_cannot_be_checked_is_refused(place, asked, tmp_path, episodes, out, said):
    with pytest.raises(ConfigError, match=said):
        dataset.check_dataset(place, replace(SETTINGS, episodes=episodes), tmp_path / out, None)
    assert not asked.seen
    assert files(place) == []


def test_parts_that_a_policy_commanded_are_left_out_and_named(place, asked, tmp_path):
    (place / "runs" / "000_near" / "policy.json").write_text('{"class": "x", "sha256": "0"}')
    found = dataset.check_dataset(place, replace(SETTINGS, episodes=2), tmp_path / "check", None)
    assert found.left_out == ("runs/000_near",)
    assert "Nothing was flown of runs/000_near" in (place / card.README).read_text()
    (place / "runs" / "001_far" / "policy.json").write_text('{"class": "x", "sha256": "0"}')
    with pytest.raises(ConfigError, match="all its parts"):
        dataset.check_dataset(place, SETTINGS, tmp_path / "other", None)


def test_a_damaged_spot_check_is_said_and_taken_away_by_repair(place, asked, tmp_path, monkeypatch):
    dataset.check_dataset(place, SETTINGS, tmp_path / "check", None)
    (place / gaps.SPOT_CHECK_FILE).write_text("{")
    with pytest.raises(ConfigError, match=r"spotcheck\.json"):
        card.write_readme(place, manifest.read_manifest(place), index.read_index(place))
    monkeypatch.setattr(figures, "plot_figures", lambda *_: None)
    assert repair.repair_dataset(place, Progress()).damaged == (gaps.SPOT_CHECK_FILE,)
    assert gaps.read_spot_check(place) is None
    assert files(place) == []
    assert "Real autopilots have not flown" in (place / card.README).read_text()


def test_a_disk_that_gives_out_is_said(place, asked, tmp_path, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(gaps, "write_spot_check", full)
    with pytest.raises(RunError, match="No space left"):
        dataset.check_dataset(place, SETTINGS, tmp_path / "check", None)
    assert files(place) == []


def test_figures_are_drawn_of_any_dataset_alike(whole, tmp_path):
    """Each the same bytes again, small enough to lie beside the card."""
    copy = shutil.copytree(whole, tmp_path / "copy")
    found, table = manifest.read_manifest(copy), index.read_index(copy)
    names = (figures.COUNTS_FILE, figures.LENGTHS_FILE, figures.FLIGHTS_FILE)
    figures.plot_figures(copy, found, table)
    drawn = {name: (copy / name).read_bytes() for name in names}
    assert sum(map(len, drawn.values())) < 300_000
    assert all(len(data) > 5_000 for data in drawn.values())
    assert isinstance(figures.plot_counts(found, table, {"reached": 3}), Figure)
    figures.plot_figures(copy, found, table)
    assert drawn == {name: (copy / name).read_bytes() for name in names}
