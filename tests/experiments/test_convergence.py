"""The convergence study runs, orders its schemes as it should, and writes where it is told."""

import math

import pytest

from angler_experiments import convergence
from angler_mjx.errors import ConfigError


@pytest.fixture(scope="module")
def rows():
    return convergence.study(
        seconds=3.0,
        cases=convergence.CASES[:1],
        steps_ms=(20, 10),
        variants=convergence.VARIANTS[:1],
    )


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


def test_table_goes_between_the_markers(rows, tmp_path):
    page = tmp_path / "page.md"
    begin, end = convergence.MARKERS
    page.write_text(f"before\n{begin}\nold\n{end}\nafter\n")
    convergence.write_between_markers(page, convergence.to_markdown(rows))
    lines = page.read_text().splitlines()
    assert lines[:2] == ["before", begin]
    assert lines[-2:] == [end, "after"]
    assert len(lines) == 4 + 2 + len(rows)
    assert len({line.count("|") for line in lines[2:-2]}) == 1


def test_a_scheme_that_blows_up_is_named(rows):
    assert "blows up" in convergence.to_markdown(
        [
            convergence.Row(
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


@pytest.mark.parametrize("text", ["no markers", None])
def test_a_page_without_markers_is_refused(tmp_path, text):
    page = tmp_path / "page.md"
    if text is not None:
        page.write_text(text)
    with pytest.raises(ConfigError, match=r"page\.md"):
        convergence.write_between_markers(page, "table")
