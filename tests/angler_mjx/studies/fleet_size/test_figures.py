"""Figures of a study of the fleet's size: points and bars where its numbers are, and legible."""

import numpy as np
import pytest

from angler_mjx.studies.fleet_size import figures

SIZES = [2, 4, 8]
RATES = [(0.1, 0.05, 0.3), (0.6, 0.4, 0.8), (0.9, 0.8, 1.0)]
TIMES = [(90.0, 80.0, 100.0), (60.0, 50.0, 75.0), (40.0, 35.0, 45.0)]
NAMES = ("with modems", "without")


def condition(name):
    rows = [
        {
            "size": size,
            "rate": rate[0],
            "low": rate[1],
            "high": rate[2],
            "median_s": dict(zip(("value", "low", "high"), time, strict=True)),
            "p90_s": {"value": time[2] + 5.0},
            "horizon_s": 120.0,
        }
        for size, rate, time in zip(SIZES, RATES, TIMES, strict=True)
    ]
    answer = {"low": 4, "high": 8, "estimate": 8, "text": "8, of 4 and 8", "worlds": 300}
    return {"name": name, "sizes": rows, "answer": answer}


FOUND = {
    "name": "survey",
    "deadline_s": 100.0,
    "worlds": 900,
    "probability": 0.8,
    "sizes": SIZES,
    "levels": {"answer": 0.95, "share": 0.96, "quantile": 0.95},
    "conditions": [condition(name) for name in NAMES],
}


def bars(axes):
    """Points, and the ends of their bars, of each condition."""
    return [
        (line.get_xdata(), line.get_ydata(), np.array(lines.get_segments())[..., 1])
        for line, _, (lines,) in axes.containers
    ]


@pytest.mark.parametrize(
    ("draw", "numbers"),
    [(figures.plot_success, RATES), (figures.plot_time, TIMES)],
    ids=["rate", "time"],
)
def test_points_and_bars_are_at_the_numbers_of_the_study(draw, numbers):
    found = bars(draw(FOUND).axes[0])
    assert len(found) == len(NAMES)
    for x, y, ends in found:
        np.testing.assert_allclose(x, SIZES, rtol=0.02)
        np.testing.assert_allclose(y, [value for value, _, _ in numbers])
        np.testing.assert_allclose(ends, [[low, high] for _, low, high in numbers])
    # Bars of two conditions stand side by side.
    assert np.all(found[0][0] < found[1][0])


@pytest.mark.parametrize("draw", [figures.plot_success, figures.plot_time])
def test_lines_and_marks_are_wide_enough_to_be_seen_on_paper(draw):
    """Journals refuse lines under half a point; marks of 3 points are told from a line."""
    for axes in draw(FOUND).axes:
        for line, _, (lines,) in axes.containers:
            assert line.get_linewidth() >= 0.5
            assert line.get_markersize() >= 3.0
            assert np.all(lines.get_linewidth() >= 0.5)
        assert all(line.get_linewidth() >= 0.5 for line in axes.lines)
