"""The convergence study runs, orders its schemes as it should, and writes where it is told."""

import math

import pytest

from angler_experiments import convergence
from angler_mjx.testing.validation.results import TermResult, read_model


@pytest.fixture(scope="module")
def rows():
    return convergence.run_study(
        seconds=3.0,
        cases=convergence.CASES[:1],
        steps_ms=(20, 10),
        variants=convergence.VARIANTS[:1],
    )


@pytest.mark.nightly(by="test_motion.py, and angler validate runs the study")
def test_schemes_converge_at_their_order(rows):
    coarse, fine = rows
    assert (coarse.step_ms, fine.step_ms) == (20, 10)
    ratio = {name: coarse.error_cm[name] / fine.error_cm[name] for name in fine.error_cm}
    # First order halves, second order quarters; the next orders blur it.
    for name in ("Euler, world velocity", "Euler, body velocity"):
        assert 1.7 < ratio[name] < 2.4
    for name in ("explicit AB2", "ours", "Heun (two evaluations)"):
        assert 3 < ratio[name] < 6
    assert fine.error_cm["ours"] < 0.1 * fine.error_cm["Euler, body velocity"]


@pytest.mark.nightly(by="test_motion.py, and angler validate runs the study")
def test_the_result_holds_the_errors_and_the_table(rows, tmp_path, monkeypatch):
    monkeypatch.setattr(convergence, "run_study", lambda *_, **__: rows)
    convergence.main(json=tmp_path / "result.json")
    result = read_model(TermResult, tmp_path / "result.json")
    assert result.text.splitlines() == convergence.to_markdown(rows).splitlines()
    assert len({line.count("|") for line in result.text.splitlines()}) == 1
    assert {number.value for number in result.numbers.values()} == {
        row.error_cm["ours"] for row in rows
    }


@pytest.mark.nightly(by="test_motion.py, and angler validate runs the study")
def test_a_scheme_that_blows_up_is_named(rows):
    assert "blows up" in convergence.to_markdown(
        [
            convergence.ConvergenceRow(
                case="violent",
                vehicle="a",
                parameter_set="b",
                greatest_speed_mps=1.0,
                greatest_tilt_deg=1.0,
                step_ms=10,
                error_cm={"x": math.nan},
            )
        ]
    )
