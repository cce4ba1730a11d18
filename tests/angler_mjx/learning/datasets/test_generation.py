"""Datasets from their files: parts, splits, and what is kept when the making is broken off."""

import json
import subprocess
from dataclasses import replace

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from angler_mjx.cli import main
from angler_mjx.errors import ConfigError
from angler_mjx.learning.datasets import generation, index, manifest, parts
from angler_mjx.learning.datasets.config import Expert
from angler_mjx.progress import Progress
from angler_mjx.runs import multi_run, rollout
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.runs.storage.folder import Run
from angler_mjx.scenario.policy_tables import PolicyConfig
from angler_mjx.scenario.tables import PlannerConfig
from angler_mjx.shipped import find_shipped


def rewritten(file, name, *changes):
    text = file.read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = file.parent / name
    path.write_text(text)
    return path


def test_what_is_made_is_whole(made):
    found = manifest.read_manifest(made)
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
    assert not (made / multi_run.REQUEST_FILE).exists()
    text = (made / "README.md").read_text()
    assert "- here: `variants` 3; `mass` [0.97, 1.03]; `thrust` [0.9, 1.0]" in text
    assert "test_there" in text
    assert "6 flights" in text
    assert "pip install 'zarr[cast-value-rs]" in text, "plain readers need it for arrays in steps"


def test_a_tile_is_as_large_as_memory_is_to_hold(file):
    """Arrays of a world in float32, counted one by one, and no other number of worlds fits."""
    config, table = parts.read_config(file)
    made = parts.build_parts(config, table, 6, "file")
    assert generation.choose_tiles(made) == [2, 2]  # of the file
    time = made[0].scenario.time.model_copy(update={"horizon_s": 3600.0, "record_hz": 20.0})
    (tile,) = generation.choose_tiles([edited(made[0], tile=None, worlds=10**6, time=time)])
    samples, robots, obstacles = 3600 * 20, 2, 2
    # p, q, nu, target, current, pwm of 8, for each robot; p and q of each obstacle.
    least = 4 * samples * (robots * (3 + 4 + 6 + 3 + 3 + 8) + obstacles * 7)
    assert tile & (tile - 1) == 0
    assert tile * least <= 2e9 <= 4 * tile * least


def edited(part, **changes):
    return replace(part, scenario=part.scenario.model_copy(update=changes))


@pytest.mark.parametrize(
    ("episodes", "tiles"),
    [(64, [32] * 8 + [4] * 2), (1000, [128] * 10), (10**5, [128] * 10)],
)
def test_parts_of_one_team_size_share_a_tile(episodes, tiles):
    """On a CPU, whose tiles have 128 worlds at most; see the numbers of the shipped file."""
    found = reef_parts(episodes)
    by_team = sorted(
        zip((part.robots for part in found), generation.choose_tiles(found), strict=True)
    )
    assert [tile for _, tile in by_team] == tiles


def reef_parts(episodes):
    path = find_shipped("reef", "angler_mjx.learning.datasets", "dataset file")
    config, table = parts.read_config(path)
    return parts.build_parts(config, table, episodes, str(path))


def test_memory_for_the_longest_part_bounds_a_shared_tile():
    first, *others = reef_parts(1000)
    time = first.scenario.time.model_copy(update={"horizon_s": 7200.0})
    longest = edited(first, time=time)
    (tile,) = generation.choose_tiles([longest])
    assert tile < 128
    for part, shared in zip(others, generation.choose_tiles([longest, *others])[1:], strict=True):
        assert shared == (tile if part.robots == first.robots else 128)


@pytest.mark.parametrize(
    "changes",
    [
        {"engine": "mjx"},
        {"policy": PolicyConfig(name="mppi")},
        {"planner": PlannerConfig(name="grid", replan_hz=1.0)},
    ],
    ids=lambda changes: next(iter(changes)),
)
def test_parts_that_fly_slowly_have_tiles_of_their_own(changes):
    slow = [edited(part, **changes) for part in reef_parts(1000)]
    worlds = [part.scenario.worlds for part in slow]
    assert generation.choose_tiles(slow) == [min(128, n) for n in worlds]


def test_parts_of_other_worlds_share_their_programs():
    """Scene `denser` differs from `reef` in numbers of its worlds, and in their count."""
    found = reef_parts(64)
    tiles = generation.choose_tiles(found)
    pair = [i for i, part in enumerate(found) if part.robots == 4 and part.expert == "grid"][:2]
    assert [found[i].scene for i in pair] == ["reef", "denser"]
    first, second = (Simulator(found[i].scenario, tile=tiles[i]) for i in pair)
    assert first.programs is second.programs


def test_shares_are_kept_to_one_episode(file):
    config, table = parts.read_config(
        rewritten(
            file,
            "weights.toml",
            ("weight = 2.0", "weight = 2.0\nteams = [1, 2, 4]"),
            ('name = "grid"', 'name = "grid"\nweight = 3.0\n\n[[expert]]\nname = "priority"'),
        )
    )
    found = parts.build_parts(config, table, 1000, "file")
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
    ("changes", "message"),
    [
        ((("weight = 2.0", "weight = -1.0"),), "weight"),
        ((('name = "there"', 'name = "here"'),), "is there twice"),
        ((("train = 0.5", "train = 0.7"),), "must be 1"),
        ((('name = "grid"', 'name = "nobody"'),), "nobody"),
        ((("shifted = true", "set = { seed = 3 }"),), "give seed instead"),
        ((("shifted = true", "set = { time = { record_hz = 1.0 } }"),), "recorded in one way"),
    ],
)
def test_what_cannot_be_made_is_refused(file, tmp_path, changes, message):
    path = rewritten(file, "faulty.toml", *changes)
    with pytest.raises(ConfigError, match=message):
        generation.make_dataset(
            generation.read_request(path, 6), tmp_path / "out", progress=Progress()
        )
    assert not any(tmp_path.iterdir())


def test_too_few_episodes_say_how_many_would_do(file, tmp_path):
    with pytest.raises(ConfigError, match=r"--episodes 1: .* give 2 or more"):
        generation.make_dataset(
            generation.read_request(file, 1), tmp_path / "out", progress=Progress()
        )


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
        generation.make_dataset(generation.read_request(file, 6), out, progress=Progress())
    with pytest.raises(ConfigError, match="--resume"):
        generation.make_dataset(generation.read_request(file, 6), out, progress=Progress())
    with pytest.raises(ConfigError, match="other episodes"):
        generation.make_dataset(
            generation.read_request(file, 5), out, progress=Progress(), resume=True
        )
    monkeypatch.setattr(rollout, "rollout", whole)
    assert (
        generation.make_dataset(
            generation.read_request(file, 6), out, progress=Progress(), resume=True
        )
        == out
    )
    with pytest.raises(ConfigError, match="complete"):
        generation.make_dataset(
            generation.read_request(file, 6), out, progress=Progress(), resume=True
        )
    data = [p.relative_to(made) for p in made.rglob("trajectories.zarr/**/*") if p.is_file()]
    assert data
    for name in data:
        assert (out / name).read_bytes() == (made / name).read_bytes()
    assert index.read_index(out).equals(index.read_index(made))


@pytest.mark.parametrize("step", ["write_manifest", "write_index"])
def test_a_making_broken_off_at_its_end_goes_on(file, made, tmp_path, monkeypatch, step):
    out = tmp_path / "out"
    module = {"write_manifest": generation.manifest, "write_index": index}[step]

    def broken(*_):
        raise KeyboardInterrupt

    request = generation.read_request(file, 6)
    with monkeypatch.context() as patch:
        patch.setattr(module, step, broken)
        with pytest.raises(KeyboardInterrupt):
            generation.make_dataset(request, out, progress=Progress())
    assert generation.make_dataset(request, out, progress=Progress(), resume=True) == out
    assert index.read_index(out).equals(index.read_index(made))
    assert not (out / "making.json").exists()
    assert "making.json" not in (out / "sha256sums.txt").read_text()


def test_show_and_stray_folders(made, tmp_path, capsys):
    main.main(["dataset", "show", str(made)])
    assert "test_there: 2" in capsys.readouterr().out
    with pytest.raises(SystemExit):
        main.main(["dataset", "show", str(tmp_path)])
    assert "not a dataset" in capsys.readouterr().err


def test_manifests_are_not_believed(copy):
    path = copy / manifest.MANIFEST
    table = json.loads(path.read_text())
    for change, message in (
        ({"schema_version": 7}, "schema_version = 7"),
        ({"parts": [{**table["parts"][0], "path": "../elsewhere"}]}, "leaves the dataset's folder"),
        ({"parts": [{**table["parts"][0], "path": "/etc"}]}, "leaves the dataset's folder"),
        ({"episodes": 0}, "episodes"),
    ):
        path.write_text(json.dumps({**table, **change}))
        with pytest.raises(ConfigError, match=message):
            manifest.read_manifest(copy)
    path.write_text("{")
    with pytest.raises(ConfigError, match="not valid JSON"):
        manifest.read_manifest(copy)
    pq.write_table(pa.table({"a": [1]}), copy / manifest.INDEX)
    with pytest.raises(ConfigError, match="holds the columns a"):
        index.read_index(copy)


def test_an_expert_has_no_settings_of_the_policy_of_the_scenario():
    own = {"name": "mine.py:Mine", "settings": {"Mine": {"speed_mps": 1.0}}}
    tables = parts._build_expert_tables({"policy": own}, Expert(policy="mppi"))
    assert tables["policy"] == {"name": "mppi", "settings": {}}
