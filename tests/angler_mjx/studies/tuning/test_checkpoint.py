"""Damaged checkpoints: our own message and the file as it was, or a tuning to go on with."""

import dataclasses
import json

import numpy as np
import pytest

from angler_mjx.errors import AnglerError, ConfigError
from angler_mjx.studies.tuning import folder, tune
from angler_mjx.studies.tuning.search import Generation

START = folder.TuningCheckpoint(settings={"seed": 1}, provenance={"commit": None})
VALUES = (None, True, -1, 10**30, "x", [], {}, [[]], [{"costs": 1}])


def claim(out, *, resume, require=lambda checkpoint: None):
    return folder.declare_folder(START, require).acquire(out, resume=resume)


@pytest.fixture
def stored(tmp_path):
    claimed, _ = claim(tmp_path / "tuned", resume=False)
    generations = [Generation(costs=[1.0, 0.9], failed=[0, 1], gradients=None)]
    folder.save_checkpoint(claimed.building, dataclasses.replace(START, generations=generations))
    claimed.release()
    return tmp_path / "tuned", claimed.building / folder.CHECKPOINT


def test_a_whole_checkpoint_is_taken_up(stored):
    out, _ = stored
    claimed, found = claim(out, resume=True)
    assert found.generations[0].costs == [1.0, 0.9]
    with pytest.raises(ConfigError, match="another process makes this tuning"):
        claim(out, resume=True)
    claimed.release()


def test_what_is_refused_keeps_its_name_and_settings_that_are_not_there_are_other_ones(tmp_path):
    out = tmp_path / "tuned"
    claimed, _ = claim(out, resume=False)
    folder.save_checkpoint(claimed.building, folder.TuningCheckpoint(settings={}, provenance={}))
    claimed.publish()

    def require(known):
        tune._require_same(known.settings, {"seed": 1}, out)

    with pytest.raises(ConfigError, match=r"another seed \(None there, 1 here\)"):
        claim(out, resume=True, require=require)
    assert [path.name for path in tmp_path.rglob("*")] == ["tuned", folder.CHECKPOINT]


def test_damaged_checkpoints_end_in_our_errors_and_stay(stored):
    out, path = stored
    whole = path.read_bytes()
    table = json.loads(whole)
    rng = np.random.default_rng(0)
    damaged = [whole[: rng.integers(len(whole))] for _ in range(20)]
    damaged += [rng.bytes(200) for _ in range(10)]
    damaged += [json.dumps(table | {key: value}).encode() for key in table for value in VALUES]
    one = table["generations"][0]
    for key in one:
        for value in VALUES:
            changed = table | {"generations": [one | {key: value}]}
            damaged.append(json.dumps(changed).encode())
    damaged.append(b"[" * 100_000)
    refused = 0
    for data in damaged:
        path.write_bytes(data)
        said = str(path)
        try:
            claimed, _ = claim(out, resume=True)
        except AnglerError as error:
            said = str(error)
            refused += 1
        else:
            claimed.release()
        assert str(path) in said
        assert path.read_bytes() == data
    assert refused > 0.7 * len(damaged)
