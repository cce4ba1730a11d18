"""Examples and rows in files: read back as they were, refused where they are for something else."""

import json

import jax
import numpy as np
import pytest

from angler_experiments.learned_planner.evaluate.evaluation_log import EvaluationLog
from angler_experiments.learned_planner.scene import Scene
from angler_experiments.learned_planner.train import example_files
from angler_experiments.learned_planner.train.examples import Examples
from angler_experiments.learned_planner.train.from_simulation import Source
from angler_mjx.errors import ConfigError

SOURCES = (Source(worlds=4, robots=2), Source(worlds=1, preset="dense"))


def _examples():
    rng = np.random.default_rng(3)

    def some(*shape, kind=np.float32):
        return rng.normal(size=shape).astype(kind)

    scenes = Scene(
        gap=some(5, 2, 16, 9, 7, kind=np.float16),
        own=some(5, 2, 4),
        others=some(5, 2, 2, 14),
        bodies=some(5, 2, 12, 7),
        water=some(5, 2, 16, 3, kind=np.float16),
        exists=rng.random((5, 2)) < 0.5,
        body_exists=rng.random((5, 12)) < 0.5,
    )
    return Examples(
        scenes=scenes, encoded_paths=some(5, 2, 14, 4), has_path=rng.random((5, 2)) < 0.5
    )


def _never(*_):
    raise AssertionError("worlds were drawn")


def test_examples_are_drawn_once(tmp_path, monkeypatch):
    made, file, reports = _examples(), tmp_path / "there" / "examples.npz", []
    monkeypatch.setattr(
        example_files.from_simulation, "sample_sources", lambda chosen, worlds: iter([made])
    )
    first = example_files.load_or_sample(SOURCES, None, file, reports.append)
    monkeypatch.setattr(example_files.from_simulation, "sample_sources", _never)
    again = example_files.load_or_sample(SOURCES, None, file, reports.append)
    some = example_files.load_or_sample(SOURCES, 3, file, reports.append)
    for a, b, c in zip(*map(jax.tree.leaves, (first, again, some)), strict=True):
        assert a.dtype == b.dtype
        np.testing.assert_array_equal(a, b)
        np.testing.assert_array_equal(np.asarray(a)[:3], c)
    assert sorted(np.ravel(first.encoded_paths)) == sorted(np.ravel(made.encoded_paths))


def test_examples_of_other_sources_are_refused(tmp_path):
    file = tmp_path / "examples.npz"
    example_files.write_examples(file, _examples(), SOURCES)
    with pytest.raises(ConfigError, match=r"examples.npz: holds examples of other sources"):
        example_files.read_examples(file, SOURCES[:1])


@pytest.mark.parametrize("content", [b"", b"no archive"])
def test_what_is_no_file_of_examples_is_refused(tmp_path, content):
    file = tmp_path / "examples.npz"
    file.write_bytes(content)
    with pytest.raises(ConfigError, match=r"examples.npz: no examples can be read"):
        example_files.read_examples(file, SOURCES)


def test_rows_are_found_by_all_of_their_keys(tmp_path):
    file = tmp_path / "out" / "rows.json"
    EvaluationLog(file).add({"sea": "reef", "samples": 2}, {"found": 0.5})
    book = EvaluationLog(file)
    assert book.find({"sea": "reef", "samples": 2})["found"] == 0.5
    assert book.find({"sea": "reef", "samples": 3}) is None
    assert book.find({"sea": "reef"}) is None
    assert len(json.loads(file.read_text())["rows"]) == 1


def test_a_damaged_file_of_rows_is_refused(tmp_path):
    file = tmp_path / "rows.json"
    file.write_text('{"rows": [')
    with pytest.raises(ConfigError, match=r"rows.json: holds no rows"):
        EvaluationLog(file)
