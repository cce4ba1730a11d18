"""Training: the same numbers from the same seed, also after an interruption; examples of runs."""

import jax
import numpy as np
import pytest

from angler_experiments.learned_planner import checkpoint
from angler_experiments.learned_planner.shapes import NetworkSize
from angler_experiments.learned_planner.train import examples, from_runs, losses
from angler_mjx.errors import ConfigError
from angler_mjx.runs.rollout import rollout


@pytest.fixture(scope="module")
def several(made):
    return jax.tree.map(lambda leaf: np.concatenate([leaf] * 10), made)


@pytest.mark.nightly(
    by="tests/experiments/learned_planner/test_checkpoint.py::test_what_was_written_is_read"
)
def test_an_interruption_changes_no_number(several, tmp_path):
    pytest.importorskip("optax", reason="needs the extra learn")
    pytest.importorskip("orbax.checkpoint", reason="needs the extra learn")
    from angler_experiments.learned_planner.train import loop as train

    config = train.TrainConfig(
        width=NetworkSize(units=8, blocks=1), sources=(), steps=4, batch=2, rate=1e-2, call=2
    )
    reports = []
    whole = train.train(config, several, tmp_path / "whole", reports.append, validation_set=several)
    train.train(config, several, tmp_path / "parts", reports.append, stop=2, validation_set=several)
    assert not (tmp_path / "parts" / "weights.npz").exists()
    parts = train.train(config, several, tmp_path / "parts", reports.append, validation_set=several)
    assert "goes on after step 2" in reports
    for a, b in zip(jax.tree.leaves(whole), jax.tree.leaves(parts), strict=True):
        np.testing.assert_array_equal(a, b)
        assert np.isfinite(np.asarray(a, float)).all()
    curve, continued = (
        losses.read_losses(tmp_path / name / losses.FILE) for name in ("whole", "parts")
    )
    assert [row.step for row in curve] == [2, 4]
    assert curve == continued
    assert found_loss(tmp_path / "whole") == pytest.approx(curve[-1].validation_loss, rel=1e-5)
    begun = train.initial_state(config)
    assert np.abs(np.asarray(whole.params["gap"]["w"] - begun.params["gap"]["w"])).max() > 1e-3
    found = checkpoint.load_checkpoint(tmp_path / "whole" / "weights.npz")
    assert found.about["steps"] == 4
    other = train.TrainConfig(**{**vars(config), "seed": 1})
    with pytest.raises(ConfigError, match="another --out"):
        train.train(other, several, tmp_path / "whole", reports.append)


def found_loss(folder):
    return checkpoint.load_checkpoint(folder / "weights.npz").about["loss"]


def test_the_training_curve_is_read_as_written_and_drawn(tmp_path):
    file = tmp_path / losses.FILE
    assert losses.read_losses(file) == []
    rows = [losses.LossRow(500, 0.5, 0.25), losses.LossRow(1000, 0.125, float("nan"))]
    losses.write_losses(rows, file)
    assert file.read_text() == "step,loss,validation_loss\n500,0.5,0.25\n1000,0.125,nan\n"
    first, second = losses.read_losses(file)
    assert first == rows[0]
    assert second[:2] == rows[1][:2]
    assert np.isnan(second.validation_loss)
    picture = losses.plot_losses(rows, tmp_path / "losses.png")
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_the_rate_goes_up_and_then_down_over_the_steps_there_will_be():
    pytest.importorskip("optax", reason="needs the extra learn")
    pytest.importorskip("orbax.checkpoint", reason="needs the extra learn")
    from angler_experiments.learned_planner.train import loop

    config = loop.TrainConfig(
        width=NetworkSize(units=8, blocks=1), sources=(), steps=7, batch=2, rate=0.01
    )
    for steps, warm in ((4000, 300), (40, 10)):
        rates = [
            float(loop.learning_rate(config, np.int32(k), np.int32(steps)))
            for k in range(steps + 1)
        ]
        np.testing.assert_allclose(rates[warm], 0.01, rtol=1e-5)
        np.testing.assert_allclose(rates[warm // 2], 0.005, rtol=1e-5)
        np.testing.assert_allclose(rates[(warm + steps) // 2], 0.00505, rtol=1e-3)
        np.testing.assert_allclose(rates[-1], 0.0001, rtol=1e-4)


def test_a_time_decides_the_steps_once(tmp_path, monkeypatch):
    pytest.importorskip("optax", reason="needs the extra learn")
    pytest.importorskip("orbax.checkpoint", reason="needs the extra learn")
    from angler_experiments.learned_planner.train import loop

    config = loop.TrainConfig(
        width=NetworkSize(units=8, blocks=1), sources=(), steps=9000, batch=2, rate=0.01
    )
    paces = iter([1500, 250])
    monkeypatch.setattr(loop, "affordable_steps", lambda *_: next(paces))
    assert loop.limit_steps(config, None, tmp_path / "out", 60.0).steps == 1500
    assert loop.limit_steps(config, None, tmp_path / "out", 60.0).steps == 1500
    assert loop.limit_steps(config, None, tmp_path / "other", 60.0).steps == 250


@pytest.mark.nightly(
    by="tests/experiments/learned_planner/test_network.py::test_mirrored_examples_are_those_of_the_mirrored_world"
)
def test_examples_of_a_run_are_those_of_its_worlds(simulator, made, tmp_path):
    run = rollout(simulator.scenario, out=tmp_path / "run", simulator=simulator)
    read = examples.join_examples(list(from_runs.read_run(run.path, tile=4)))
    for a, b in zip(jax.tree.leaves(read), jax.tree.leaves(made), strict=True):
        np.testing.assert_allclose(np.asarray(a, float), np.asarray(b, float), atol=1e-3)
