"""Datasets mended to the bytes that they had, joined, and counted."""

import json

import pyarrow.parquet as pq
import pytest

from angler_mjx.cli import main
from angler_mjx.errors import ConfigError
from angler_mjx.learning.datasets import checksums, generation, index, manifest
from angler_mjx.learning.datasets.maintenance import merge as joining
from angler_mjx.learning.datasets.maintenance import repair as mending
from angler_mjx.learning.datasets.maintenance import summary
from angler_mjx.learning.datasets.verifying import integrity, verification
from angler_mjx.progress import Progress

from .test_generation import rewritten


def test_what_was_damaged_is_flown_again_to_the_same_bytes(copy, made, capsys):
    part = manifest.read_manifest(copy).parts[0].path
    store = copy / part / "trajectories.zarr"
    shard = store / "p_m" / "c" / "1" / "0" / "0" / "0"
    data = bytearray(shard.read_bytes())
    data[len(data) // 3] ^= 1
    shard.write_bytes(data)
    (store / "q" / "c" / "0" / "0" / "0" / "0").unlink()
    (copy / manifest.INDEX).write_bytes(b"none")
    (copy / part / "variants.json").unlink()
    (missing,) = integrity.check_parts(copy, manifest.read_manifest(copy), Progress()).findings
    assert "variants.json is 'none'" in missing.text
    main.main(["dataset", "repair", str(copy)])
    output = capsys.readouterr().out
    assert "4 files were damaged or lost" in output
    assert f"flown again: {part}" in output
    assert "other bytes" not in output
    for name in checksums.list_files(made):
        if "trajectories.zarr" in name or name.endswith((".parquet", "variants.json")):
            assert (copy / name).read_bytes() == (made / name).read_bytes(), name
    assert verification.verify_dataset(copy, 0, Progress()).agrees
    assert mending.repair_dataset(copy, Progress()).damaged == ()


@pytest.mark.parametrize("ended", [KeyboardInterrupt, ConfigError("no")])
def test_a_merge_that_is_broken_off_leaves_nothing(made, copy, tmp_path, monkeypatch, ended):
    """As by Ctrl-C, or by what the whole turns out to be."""
    table = json.loads((copy / manifest.MANIFEST).read_text())
    for part in table["parts"]:
        part["seed"] += 1
    (copy / manifest.MANIFEST).write_text(json.dumps(table))

    def broken(*_):
        raise ended

    monkeypatch.setattr(index, "write_index", broken)
    before = sorted(tmp_path.iterdir())
    with pytest.raises(ended if isinstance(ended, type) else ConfigError):
        joining.merge_datasets([made, copy], tmp_path / "both")
    assert sorted(tmp_path.iterdir()) == before


def test_what_cannot_be_flown_again_is_said(copy):
    part = manifest.read_manifest(copy).parts[0].path
    text = (copy / part / "config.json").read_text()
    (copy / part / "config.json").write_text(text + " ")
    with pytest.raises(ConfigError, match=r"config.json: defines the flights"):
        mending.repair_dataset(copy, Progress())
    (copy / part / "config.json").write_text(text)
    next((copy / part / "trajectories.zarr" / "nu").rglob("c/0/0/0/0")).unlink()
    table = json.loads((copy / manifest.MANIFEST).read_text())
    table["environment"]["device"] = "another"
    (copy / manifest.MANIFEST).write_text(json.dumps(table))
    with pytest.raises(ConfigError, match=r"made with another device.*--accept"):
        mending.repair_dataset(copy, Progress())
    (copy / manifest.SUMS).unlink()
    with pytest.raises(ConfigError, match="damage cannot be located"):
        mending.repair_dataset(copy, Progress())


@pytest.mark.nightly(
    by="tests/angler_mjx/learning/datasets/test_verifying.py::test_an_environment_in_two_splits_is_found"
)
def test_datasets_become_one(file, made, tmp_path):
    other = rewritten(file, "other.toml", ("seed = 4", "seed = 5"))
    second = generation.make_dataset(
        generation.read_request(other, 3), tmp_path / "second", progress=Progress()
    )
    out = joining.merge_datasets([made, second], tmp_path / "both")
    assert verification.verify_dataset(out, 0, Progress()).agrees
    found, table = manifest.read_manifest(out), index.read_index(out)
    assert (found.name, found.episodes, len(found.parts)) == ("both", 9, 4)
    assert table["episode"].to_pylist() == list(range(9))
    kept = ("world", "seed", "environment", "split", "energy_j")
    before = [row for store in (made, second) for row in index.read_index(store).to_pylist()]
    for row, old in zip(table.to_pylist(), before, strict=True):
        assert {name: row[name] for name in kept} == {name: old[name] for name in kept}
    with pytest.raises(ConfigError, match="in the same worlds as"):
        joining.merge_datasets([out, second], tmp_path / "more")
    changed = json.loads((second / manifest.MANIFEST).read_text())
    changed["time"]["record_hz"] = 1.0
    (second / manifest.MANIFEST).write_text(json.dumps(changed))
    with pytest.raises(ConfigError, match=r"time of .* is not that of"):
        joining.merge_datasets([made, second], tmp_path / "more")
    assert not (tmp_path / "more").exists()


def test_numbers_are_those_of_the_rows(made, capsys):
    found = summary.compute_stats(made)
    rows = [
        row
        for part in manifest.read_manifest(made).parts
        for row in pq.read_table(made / part.path / "episodes.parquet").to_pylist()
    ]
    assert found["robots"] == len(rows) == sum(found["outcomes"].values())
    assert found["outcomes"].get("timeout", 0) == sum(row["outcome"] == "timeout" for row in rows)
    assert sum(one["episodes"] for one in found["by"]["split"].values()) == 6
    assert len(found["fields"]["nu"]["mean"]) == 6
    main.main(["dataset", "stats", str(made), "--json"])
    assert json.loads(capsys.readouterr().out)["episodes"] == 6
    main.main(["dataset", "stats", str(made)])
    assert "standard deviation" in capsys.readouterr().out
