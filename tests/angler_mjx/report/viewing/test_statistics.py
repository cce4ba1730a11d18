"""Figures about all robots: bars, curves and intervals say what the table says."""

import numpy as np
import pyarrow as pa
import pytest
from matplotlib.patches import Rectangle

from angler_mjx.errors import ConfigError
from angler_mjx.report.plotting import style
from angler_mjx.report.viewing import statistics
from angler_mjx.runs.storage.confidence_intervals import clustered_rates
from angler_mjx.runs.storage.results import OUTCOMES

KINDS = (("bluerov2", "blue_gazebo"), ("bluerov2_heavy", "wu2018"))


def make_episodes(counts, separation=1.0, completed_s=None):
    """Robots by outcome, half of each kind, four a world; times of worlds with a task."""
    outcome = [name for name, count in counts.items() for _ in range(count)]
    n = len(outcome)
    arrived = np.array([name == "reached" for name in outcome])
    return pa.table(
        {
            "world": np.arange(n) // 4,
            "vehicle": [KINDS[i % 2][0] for i in range(n)],
            "parameter_set": [KINDS[i % 2][1] for i in range(n)],
            "outcome": outcome,
            "time_to_goal_s": np.where(arrived, 40.0 + np.arange(n), np.nan).astype(np.float32),
            "min_clearance_m": np.where(arrived, 0.3, 0.0).astype(np.float32),
            "min_separation_m": np.full(n, separation, np.float32),
            "task_progress": pa.array([None if completed_s is None else 0.5] * n, pa.float32()),
            "task_completed_s": pa.array(
                [None if completed_s is None else completed_s[i // 4] for i in range(n)],
                pa.float32(),
            ),
        }
    )


COUNTS = {"reached": 12, "collision_static": 4, "collision_robot": 2, "timeout": 2}


@pytest.fixture(scope="module")
def episodes():
    return make_episodes(COUNTS)


def test_bars_are_the_rates_and_lines_their_intervals(episodes):
    axes = statistics.plot_outcomes(episodes, "name").axes[0]
    bars = [patch for patch in axes.patches if isinstance(patch, Rectangle)]
    ended = np.array(episodes["outcome"].to_pylist())
    rates = clustered_rates(
        {name: ended == name for name in OUTCOMES}, episodes["world"].to_numpy()
    )
    for bar, line, outcome in zip(bars, axes.lines, OUTCOMES, strict=True):
        assert bar.get_width() == pytest.approx(COUNTS.get(outcome, 0) / 20)
        assert line.get_xdata() == pytest.approx((rates[outcome].low, rates[outcome].high))


def test_bars_of_a_kind_fill_the_whole(episodes):
    axes = statistics.plot_outcomes(episodes, "name").axes[1]
    widths = np.array([patch.get_width() for patch in axes.patches]).reshape(2, len(OUTCOMES))
    np.testing.assert_allclose(widths.sum(axis=1), 1.0)
    assert [label.get_text() for label in axes.get_yticklabels()] == [
        "bluerov2\nblue_gazebo (10)",
        "bluerov2_heavy\nwu2018 (10)",
    ]


def test_arrival_curves_level_off_at_the_rate_of_arrival(episodes):
    axes = statistics.plot_times(episodes, "name", 120.0).axes[0]
    for line in axes.lines:
        share = line.get_ydata()
        assert np.all(np.diff(share) >= 0)
        assert share[-1] == pytest.approx(0.6)  # 6 of the 10 robots of each kind
        assert line.get_xdata()[-1] == 120.0


def test_of_a_task_its_completion_is_drawn_first():
    """Robots are done early, worlds late: three of five, half of them by 90 s."""
    task = make_episodes(COUNTS, completed_s=[80.0, 90.0, None, 100.0, None])
    figure = statistics.plot_times(task, "name", 120.0)
    line = figure.axes[0].lines[0]
    assert line.get_label() == "task completed: median 90 s"
    assert line.get_xdata().tolist() == [0.0, 80.0, 90.0, 100.0, 120.0]
    assert line.get_ydata() == pytest.approx([0.0, 0.2, 0.4, 0.6, 0.6])
    titles = [text.get_text() for text in figure.texts]
    assert "name: half of the tasks that are completed take at most 90 s" in titles
    titles = [text.get_text() for text in statistics.plot_outcomes(task, "name").texts]
    assert "name: 60 % of tasks completed, 60 % of robots did their part" in titles


def test_legends_of_histograms_cover_no_bar(episodes):
    figure = statistics.plot_distances(episodes, "name")
    figure.draw_without_rendering()
    for axes in figure.axes:
        legend = axes.get_legend().get_window_extent()
        bars = [patch.get_window_extent() for patch in axes.patches if patch.get_height() > 0]
        assert bars
        assert not any(legend.overlaps(bar) for bar in bars)
        assert legend.y1 <= figure.bbox.y1


def test_histograms_hold_every_robot(episodes):
    figure = statistics.plot_distances(episodes, "name")
    assert len(figure.axes) == 2
    for axes in figure.axes:
        bars = [patch for patch in axes.patches if isinstance(patch, Rectangle)]
        assert sum(bar.get_height() for bar in bars) == 20


def test_a_fleet_of_one_has_no_separation_to_show():
    alone = make_episodes(COUNTS, separation=np.inf)
    assert len(statistics.plot_distances(alone, "name").axes) == 1


@pytest.mark.parametrize("outcome", ["timeout", "collision_static"])
def test_a_run_in_which_nobody_arrives_can_be_drawn(outcome, tmp_path):
    episodes = make_episodes({outcome: 4})
    for i, figure in enumerate(
        (
            statistics.plot_outcomes(episodes, "name"),
            statistics.plot_distances(episodes, "name"),
            statistics.plot_times(episodes, "name", 120.0),
        )
    ):
        assert style.save_figure(figure, tmp_path / f"{i}.png").stat().st_size > 10_000


def test_every_outcome_has_a_colour_and_words():
    assert set(style.OUTCOMES) == set(style.OUTCOME_TEXT) == set(OUTCOMES)
    assert len(set(style.OUTCOMES.values())) == len(OUTCOMES)


@pytest.mark.parametrize(
    ("name", "said"), [("rows.jsonl", r"as \.jsonl"), ("figure", "as a name without ending")]
)
def test_a_name_that_is_none_of_a_figure_is_refused_before_anything_is_written(
    tmp_path, name, said
):
    with pytest.raises(ConfigError, match=rf"{name}: a figure cannot be written {said}; .*\.png"):
        style.save_figure(style.new_figure(2.0, 2.0, headline_in=0.5), tmp_path / "new" / name)
    assert not (tmp_path / "new").exists()
