"""Episodes that are chosen: the shares that were wished for, always the same, no more than must."""

import json

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from angler_mjx.cli import main
from angler_mjx.errors import ConfigError
from angler_mjx.learning import datasets
from angler_mjx.learning.datasets import (
    card,
    generation,
    index,
    manifest,
    manifest_building,
    sampling,
)
from angler_mjx.learning.datasets.sampling import DIFFICULTIES, SampleConfig

SPLITS = ("train", "val", "test")


def sampled(n, seed, trivial=0.35, failed=0.3):
    """An index of n episodes of three splits and a shifted scene."""
    rng = np.random.default_rng(seed)
    rest = [(1.0 - trivial) / (len(DIFFICULTIES) - 1)] * (len(DIFFICULTIES) - 1)
    return pa.table(
        {
            "split": rng.choice([*SPLITS, "test_far"], n).tolist(),
            "difficulty": rng.choice(DIFFICULTIES, n, p=[trivial, *rest]).tolist(),
            "success": rng.random(n) >= failed,
            "seed": rng.choice([11, 17], n),
            "world": np.arange(n),
        }
    )


def fractions(table, keep):
    """Of each split's kept episodes, counted one by one."""
    found = {}
    for split in (*SPLITS, "test_far"):
        rows = [
            r for r, k in zip(table.to_pylist(), keep, strict=True) if k and r["split"] == split
        ]
        count = max(len(rows), 1)
        found[split] = {d: sum(r["difficulty"] == d for r in rows) / count for d in DIFFICULTIES}
        found[split]["failed"] = sum(not r["success"] for r in rows) / count
        found[split]["n"] = len(rows)
    return found


def test_every_split_has_the_shares_and_shifted_scenes_are_left_alone():
    table = sampled(6000, 0)
    wished = SampleConfig(at_most={"trivial": 0.2, "failed": 0.1}, at_least={"crossing": 0.27})
    found = fractions(table, sampling.select_episodes(table, wished, SPLITS))
    before = fractions(table, np.ones(6000, bool))
    for split in SPLITS:
        assert found[split]["trivial"] <= 0.2
        assert found[split]["failed"] <= 0.1
        assert found[split]["crossing"] >= 0.27
        # More are left than half, and no bound is kept by more than an episode's worth of need.
        assert found[split]["n"] > before[split]["n"] / 2
        assert found[split]["failed"] > 0.09
    assert found["test_far"] == before["test_far"]


def test_of_one_kind_no_more_is_taken_than_must_be():
    table = sampled(4000, 1)
    keep = sampling.select_episodes(table, SampleConfig(at_most={"trivial": 0.1}), SPLITS)
    trivial = np.array([d == "trivial" for d in table["difficulty"].to_pylist()])
    train = np.array([s == "train" for s in table["split"].to_pylist()])
    assert keep[~trivial].all()
    left, others = (trivial & keep & train).sum(), (~trivial & train).sum()
    assert left / (left + others) <= 0.1 < (left + 1) / (left + 1 + others)
    # Whoever failed among the trivial ones stays as often as whoever did not.
    failed = ~table["success"].to_numpy(zero_copy_only=False)
    all_of, kept_of = ((failed & trivial & train)[w].sum() for w in (slice(None), keep))
    assert abs(kept_of / left - all_of / (trivial & train).sum()) <= 1 / left


@settings(max_examples=60, deadline=None)
@given(
    counts=st.lists(st.integers(0, 3000), min_size=8, max_size=8),
    trivial=st.floats(0.0, 1.0),
    failed=st.floats(0.0, 1.0),
    crossing=st.floats(0.0, 1.0),
)
def test_whatever_there_is_bounds_hold(counts, trivial, failed, crossing):
    wished = SampleConfig(
        at_most={"trivial": trivial, "failed": failed}, at_least={"crossing": crossing}
    )
    kept = sampling.thin_counts(np.array(counts), wished.upper_bounds())
    total = kept.sum()
    assert (kept >= 0).all()
    assert (kept <= counts).all()
    assert kept[:2].sum() <= trivial * total + 1e-6
    assert kept[1::2].sum() <= failed * total + 1e-6
    assert kept[2:4].sum() >= crossing * total - 1e-6


def test_choice_is_of_the_episode_and_not_of_its_row():
    table = sampled(900, 2)
    wished = SampleConfig(at_most={"trivial": 0.1})
    keep = sampling.select_episodes(table, wished, SPLITS)
    order = np.random.default_rng(3).permutation(900)
    assert (sampling.select_episodes(table.take(order), wished, SPLITS) == keep[order]).all()
    # Worlds that lie together are no more alike than others.
    tickets = sampling.hash_worlds(np.full(4000, 5), np.arange(4000)) / 2.0**64
    assert abs(tickets.mean() - 0.5) < 4 * np.sqrt(1 / 12 / 4000)
    assert abs(np.corrcoef(tickets[:-1], tickets[1:])[0, 1]) < 4 / np.sqrt(4000)


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"at_most": {"trivial": 1.2}}, r"at_most.trivial = 1.2: must be from 0 to 1"),
        (
            {"at_most": {"crossing": 0.1}, "at_least": {"crossing": 0.3}},
            "at_least.crossing = 0.3 is more than at_most.crossing = 0.1",
        ),
        ({"at_least": {"trivial": 0.6, "blocked": 0.6}}, "= 1.2: must be 1 or less"),
        ({"at_most": dict.fromkeys(DIFFICULTIES, 0.2)}, "= 0.8: must be 1 or more"),
        ({"at_most": {"easy": 0.2}}, "easy"),
    ],
)
def test_shares_that_cannot_be_are_refused(table, message):
    with pytest.raises(ValidationError, match=message):
        SampleConfig(**table)


def test_bounds_of_one_kind_may_lie_apart_or_together():
    for least, most in ((0.2, 0.5), (0.3, 0.3)):
        wished = SampleConfig(at_least={"blocked": least}, at_most={"blocked": most})
        table = sampled(2000, 4)
        found = fractions(table, sampling.select_episodes(table, wished, SPLITS))
        for split in SPLITS:
            assert least - 0.01 <= found[split]["blocked"] <= most + 1e-9


@pytest.mark.parametrize("kind", ["crossing", "both"])
def test_crossings_of_single_robots_are_refused_before_anything_is_flown(file, tmp_path, kind):
    text = file.read_text().replace("weight = 2.0", "weight = 2.0\nteams = [1]")
    path = file.parent / "alone.toml"
    path.write_text(text + f"\n[sample]\nat_least = {{ {kind} = 0.1 }}\n")
    with pytest.raises(ConfigError, match=rf"sample.at_least.{kind} = 0.1: .* teams of two"):
        generation.make_dataset(generation.read_request(path, 6), tmp_path / "out", progress=None)
    assert not any(tmp_path.iterdir())


def test_readers_are_given_the_chosen_ones(copy, capsys):
    """As if it had been made with that wish: nothing of a flight depends on it."""
    wished = {"at_most": {"trivial": 0.5}, "at_least": {}}
    table = json.loads((copy / manifest.MANIFEST).read_text()) | {"sample": wished}
    (copy / manifest.MANIFEST).write_text(json.dumps(table))
    found = index.build_index(copy, manifest.read_manifest(copy))
    index.write_index(copy, found)
    sampled = [(row["split"], row["difficulty"]) for row in found.to_pylist()[:4]]
    assert sorted(sampled) == [
        ("train", "blocked"),
        *[("train", "trivial")] * 2,
        ("val", "trivial"),
    ]
    # Of the two trivial ones of train one is too many, and of val the only one.
    assert len(datasets.open(copy, split="train")) == 2
    assert len(datasets.open(copy, split="train", chosen=False)) == 1
    assert len(datasets.open(copy, split="train", chosen=None)) == 3
    assert len(datasets.open(copy, split="test_there")) == 2
    with pytest.raises(ConfigError, match="none of these 1 episodes is chosen; give chosen=None"):
        datasets.open(copy, split="val")
    whole = manifest_building.add_counts(manifest.read_manifest(copy), found)
    manifest.write_manifest(copy, whole)
    assert whole.chosen == {"test_there": 2, "train": 2}
    main.main(["dataset", "show", str(copy)])
    message = " ".join(capsys.readouterr().out.split())
    assert "chosen of test_there: 2 of 2, train: 2 of 3, val: 0 of 1" in message
    card.write_readme(copy, whole, found)
    text = (copy / card.README).read_text()
    assert "| trivial | at most 50 % | 75.0 | 50.0 |" in text
    assert "| failed | any | 100.0 | 100.0 |" in text
