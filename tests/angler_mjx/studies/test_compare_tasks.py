"""Two runs with a task against each other: its completion comes first, robots after it."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from angler_mjx.scenario.scenario import load_scenario
from angler_mjx.studies import compare, comparison_report

from .test_paired import episodes

COMPLETED_S = ([60.0, 80.0, 70.0, None], [61.0, 95.0, None, None])


def run(name, reached, times_s, completed_s):
    """As much of a run as is compared."""
    return SimpleNamespace(
        path=Path(name),
        scenario=load_scenario("reef_survey"),
        episodes=episodes(np.asarray(reached, bool), np.asarray(times_s), completed_s=completed_s),
    )


@pytest.fixture(scope="module")
def found():
    """With modems robots stop earlier and tasks are completed later, or not at all."""
    all_, early = np.ones((4, 2)), np.full((4, 2), 40.0)
    first = run("perfect", all_, 50.0 * all_, COMPLETED_S[0])
    second = run("modems", all_, early, COMPLETED_S[1])
    return compare.compare_runs(first, second)


def test_the_text_begins_with_the_completion_of_the_task(found):
    lines = comparison_report.format_comparison(found).splitlines()
    costs = [line for line in lines if line.strip().startswith("time")]
    # Worlds 0 and 1 completed it in both: 70 s, then 78 s.
    assert costs[0].startswith("  time to completion of the task: 70 -> 78 s, change +8 (")
    assert costs[1].startswith("  time until a robot did its part: 50 -> 40 s, change -10 (")
    text = "\n".join(lines)
    assert "goal" not in text
    assert "arrived" not in text
    assert text.index("tasks completed: 75.0 % -> 50.0 %") < text.index("robots that did their")


def test_the_figure_begins_with_the_completion_of_the_task(found):
    axes = comparison_report.plot_comparison(found).axes
    names = [[label.get_text() for label in one.get_yticklabels()] for one in axes]
    assert names[0][0] == "tasks completed"
    assert names[1][:2] == ["time to completion of the task", "time until a robot did its part"]
    points = [line.get_xdata()[0] for line in axes[1].lines if line.get_marker() == "o"]
    assert points[:2] == pytest.approx([100 * 8 / 70, -20.0])


def test_worlds_are_ordered_by_what_became_of_their_tasks(found):
    """World 2 was completed in the first run alone, 1 is 15 s later, 0 is 1 s later."""
    assert [one["world"] for one in found["changed"]] == [2, 1, 0, 3]
    text = comparison_report.format_comparison(found)
    assert "world 2: task: 70.0 s -> not completed; 2 -> 2 did their part" in text


def test_a_world_whose_task_alone_changed_has_changed():
    all_ = np.ones((2, 2))
    pair = [run(name, all_, all_, times) for name, times in (("a", [9.0, 5.0]), ("b", [9.0, 6.0]))]
    assert [one["world"] for one in compare.compare_runs(*pair)["changed"]] == [1]
    assert compare.compare_runs(pair[0], pair[0])["changed"] == []


def test_runs_without_a_task_speak_of_goals():
    all_ = np.ones((2, 2))
    pair = [run(name, all_, all_ * time_s, None) for name, time_s in (("a", 10.0), ("b", 11.0))]
    found = compare.compare_runs(*pair)
    assert "time to goal: 10 -> 11 s" in comparison_report.format_comparison(found)
    assert found["changed"][0]["task"] is None


def test_of_many_worlds_the_most_changed_are_listed_and_the_others_counted():
    all_ = np.ones((14, 1))
    pair = [run("a", all_, 10.0 * all_, None), run("b", all_, 10.0 * all_, None)]
    later = 10.0 * all_ + 1.0 + np.arange(14)[:, None]
    pair[1].episodes = episodes(np.ones((14, 1), bool), later)
    lines = comparison_report.format_comparison(compare.compare_runs(*pair)).splitlines()
    assert lines[-1] == "  and 4 more; --json lists all"
    assert [line.split()[1] for line in lines[-11:-1]] == [f"{i}:" for i in range(13, 3, -1)]
    pair[1].episodes = episodes(np.ones((14, 1), bool), np.where(later > 15.0, later, 10.0))
    assert "--json lists all" not in comparison_report.format_comparison(
        compare.compare_runs(*pair)
    )


def test_the_figure_has_its_line_at_no_change_and_leaves_out_what_has_no_percentage():
    """A mean that was 0 has no change in % of itself."""
    all_ = np.ones((6, 2))
    found = compare.compare_runs(
        run("a", all_, 10.0 * all_, None), run("b", all_, 11.0 * all_, None)
    )
    found["costs"]["min_clearance_m"] |= {"first": 0.0}
    figure = comparison_report.plot_comparison(found)
    for axes in figure.axes:
        assert list(axes.lines[0].get_xdata()) == [0.0, 0.0]
        assert all(line.get_linewidth() >= 0.5 for line in axes.lines)  # as journals demand
    names = [label.get_text() for label in figure.axes[1].get_yticklabels()]
    assert names == ["time to goal", "energy", "way"]
