"""Figures of a report: their legends and sizes, by what matplotlib draws."""

from dataclasses import replace

import numpy as np
import pytest

from angler_mjx.studies.benchmark.report import curves, scene_maps, scenes
from angler_mjx.studies.benchmark.report.reading import Runs


@pytest.fixture(scope="module")
def example(results):
    return scenes.read_example(results.examples[0])


def look_of(line):
    return line.get_linewidth(), line.get_linestyle(), line.get_marker(), line.get_markersize()


def test_the_legend_of_an_example_shows_lines_and_marks_as_they_are_on_the_maps(example):
    way = replace(example.paths[0], outcome=["timeout"] * len(example.start_m))
    figure = scene_maps.plot_example(replace(example, paths=[way]))
    drawn = {look_of(line) for axes in figure.axes for line in axes.lines}
    shown = {line.get_label(): look_of(line) for line in figure.legends[0].get_lines()}
    assert {"planned", "flown", "goal (disc: start)", "failure"} <= set(shown)
    assert set(shown.values()) <= drawn


def map_in(example, count):
    """Width and height of the first of ``count`` maps, and the width of the figure, inch."""
    figure = scene_maps.plot_example(replace(example, paths=example.paths[:1] * count))
    figure.draw_without_rendering()
    box = figure.axes[0].get_window_extent().transformed(figure.dpi_scale_trans.inverted())
    return box.width, box.height, figure.get_figwidth()


def test_maps_of_examples_are_as_large_in_two_rows_and_fill_the_width(example):
    one, two = map_in(example, 4), map_in(example, 8)
    np.testing.assert_allclose(one, two, rtol=0.03)
    width, height, whole = one
    assert width == pytest.approx(height, rel=0.01)  # of a square reef
    assert 4 * width > 0.8 * whole


def panel_in(results, names):
    """Height of a panel of failures, in scenes that are called so, inch."""
    scene = np.array(list(names), object)[np.arange(len(results.runs)) % len(names)]
    runs = Runs({**results.runs.columns, "scene": scene})
    about = {**results.about, "scenes": list(names)}
    figure = scene_maps.plot_failures(replace(results, runs=runs, about=about))
    figure.draw_without_rendering()
    panels = [axes for axes in figure.axes if axes.get_visible()]
    assert len(panels) == len(names)
    return panels[0].get_window_extent().height / figure.dpi


def test_panels_of_failures_are_as_high_in_two_rows(results):
    assert panel_in(results, "abc") == pytest.approx(panel_in(results, "abcdef"), rel=0.03)


@pytest.mark.parametrize("count", [2, 9])
def test_each_team_has_two_inches_of_planning_times(results, count):
    teams = 1 + np.arange(len(results.runs)) % count
    runs = Runs({**results.runs.columns, "robots": teams})
    figure = curves.planning_time(replace(results, runs=runs))
    assert len(figure.axes[0].get_xticks()) == count
    assert figure.get_figwidth() >= 2.0 * count
