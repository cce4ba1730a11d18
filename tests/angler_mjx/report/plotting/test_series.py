"""Series of figures: which look alike, and how axes and panels are laid out."""

from itertools import combinations

import pytest

from angler_mjx.report.plotting import series, style


def test_sixteen_series_look_different():
    looks = [(*series.line_style(i).values(), series.marker_style(i)) for i in range(16)]
    assert all(a != b for a, b in combinations(looks, 2))


def test_fractions_are_written_as_per_cents_with_a_blank():
    with style.titled_figure(4.0, 3.0, "title", "subtitle") as figure:
        axes = figure.subplots()
        series.format_fraction_axis(axes)
    figure.draw_without_rendering()
    assert "80 %" in [label.get_text() for label in axes.get_yticklabels()]


@pytest.mark.parametrize("count", [1, 4, 5])
def test_only_as_many_panels_as_are_needed_are_seen(count):
    with style.titled_figure(4.0, 3.0, "title", "subtitle") as figure:
        panels = series.add_panels(figure, count, 3)
    assert [axes for axes in figure.axes if axes.get_visible()] == panels
    assert len(panels) == count


def test_the_headline_stands_above_the_panels():
    with style.titled_figure(6.0, 4.0, "title", "subtitle") as figure:
        axes = figure.subplots()
    figure.draw_without_rendering()
    lowest = min(text.get_window_extent().y0 for text in figure.texts)
    assert axes.get_tightbbox().y1 <= lowest


def test_dollars_in_names_are_no_formulas_where_users_name_things():
    with style.titled_figure(4.0, 3.0, "a $x$", "$y$", parse_math=False) as figure:
        pass
    assert not any(text.get_parse_math() for text in figure.texts)
