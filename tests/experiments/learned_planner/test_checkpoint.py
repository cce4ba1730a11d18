"""Checkpoints: written and read back, and refused where they are for something else."""

import json
import tomllib
from pathlib import Path

import jax
import numpy as np
import pytest

from angler_experiments.learned_planner import checkpoint, network
from angler_experiments.learned_planner.checkpoint import Checkpoint
from angler_experiments.learned_planner.planner import LearnedPlanner, LearnedSettings
from angler_experiments.learned_planner.shapes import SCHEMA, NetworkSize
from angler_mjx.errors import ConfigError
from angler_mjx.planning.register import PlannerReference, PlannerSpec

WIDTH = NetworkSize(units=8, blocks=1)


@pytest.fixture
def file(tmp_path):
    made = Checkpoint(
        params=network.init_params(jax.random.key(4), WIDTH), width=WIDTH, about={"worlds": 12}
    )
    path = tmp_path / "weights.npz"
    checkpoint.save_checkpoint(path, made)
    return path


def _edited(file: Path, **changes):
    with np.load(file) as held:
        arrays = dict(held)
    about = json.loads(arrays["about"].tobytes()) | changes
    arrays["about"] = np.frombuffer(json.dumps(about).encode(), np.uint8)
    np.savez(file, **arrays)


def test_what_was_written_is_read(file):
    found = checkpoint.load_checkpoint(file)
    expected = network.init_params(jax.random.key(4), WIDTH)
    assert (found.width, found.about) == (WIDTH, {"worlds": 12})
    assert jax.tree.structure(found.params) == jax.tree.structure(expected)
    for a, b in zip(jax.tree.leaves(found.params), jax.tree.leaves(expected), strict=True):
        np.testing.assert_array_equal(a, np.asarray(b).astype(np.float16).astype(np.float32))


def test_one_of_another_schema_is_refused(file):
    _edited(file, schema=SCHEMA + 1)
    with pytest.raises(ConfigError, match=f"schema {SCHEMA + 1}.*reads schema {SCHEMA}; train it"):
        LearnedPlanner(LearnedSettings(checkpoint=str(file)))


def test_one_of_another_width_is_refused(file):
    _edited(file, width={"units": 12, "blocks": 1})
    with pytest.raises(ConfigError, match=r"has the shape .*damaged"):
        checkpoint.load_checkpoint(file)


@pytest.mark.parametrize("content", [b"", b"no archive", None])
def test_what_is_none_is_refused(tmp_path, content):
    path = tmp_path / "weights.npz"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ConfigError, match=r"weights.npz: no checkpoint.*leave planner.learned"):
        checkpoint.load_checkpoint(path)


def test_the_shipped_one_is_small_and_plans():
    shipped = Path(checkpoint.__file__).with_name(checkpoint.SHIPPED_FILE)
    assert shipped.stat().st_size < 5e6
    assert checkpoint.load_checkpoint().about["worlds"] > 0


def test_the_entry_point_names_the_planner():
    table = tomllib.loads(
        (Path(__file__).parents[3] / "experiments" / "pyproject.toml").read_text()
    )
    entry = table["project"]["entry-points"]["angler_mjx.planners"]["learned"]
    module, _, name = entry.partition(":")
    spec = PlannerSpec(
        reference=PlannerReference(name="learned", module=module, qualname=name),
        settings={"samples": 2},
    )
    planner = spec.make()
    assert planner.settings.samples == 2
    assert callable(planner.plan_batch)
