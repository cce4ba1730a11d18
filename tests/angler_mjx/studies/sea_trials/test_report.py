"""Panels of the figure of sea trials, from motions of closed form."""

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from angler_mjx.studies.sea_trials.check_vehicle import VehicleCheck
from angler_mjx.studies.sea_trials.program import SAMPLE_S, TrialMotion
from angler_mjx.studies.sea_trials.report import plot_check

BEGIN_S, END_S = 10.0, 60.0
TIME_S = SAMPLE_S * np.arange(round(END_S / SAMPLE_S) + 1)
LATER_S = np.clip(TIME_S - BEGIN_S, 0.0, None)


def move(surge=None, yaw_rad=None, steering=None):
    """Return a level motion with a surge, a heading and a sign of steering [T]."""
    zero = np.zeros_like(TIME_S)
    surge, yaw = (zero if x is None else x for x in (surge, yaw_rad))
    return TrialMotion(
        time_s=TIME_S,
        p=np.zeros((len(TIME_S), 3)),
        q=np.stack([np.cos(yaw / 2), zero, zero, np.sin(yaw / 2)], axis=1),
        nu=np.stack([surge, *[zero] * 5], axis=1),
        steering=zero + 1.0 if steering is None else steering,
    )


@pytest.fixture
def plot():
    """A function: the panels of a check, by title, as they are rendered."""

    def render(motions, left_out=(), *, level=False):
        check = VehicleCheck(
            vehicle="simple",
            parameter_set="round",
            level=level,
            measures=(),
            left_out=dict(left_out),
            motions=motions,
            execute_index=round(BEGIN_S / SAMPLE_S),
            spiral=np.empty((0, 3)),
        )
        figure = plot_check(check)
        FigureCanvasAgg(figure).draw()
        return {axes.get_title(loc="left"): axes for axes in figure.axes}

    return render


def read_lines(axes):
    return {line.get_label(): line.get_xydata() for line in axes.lines}


def test_a_crash_stop_ends_where_the_vehicle_goes_astern_and_a_coasting_stop_with_the_trial(plot):
    """Surge falls by 0.1 m/s a second from 1 m/s: it is 0 after 10 s, and then negative."""
    falling = move(surge=1.0 - 0.1 * LATER_S)
    lines = read_lines(plot({"coasting stop": falling, "crash stop": falling})["stop"])
    assert set(lines) == {"coasting stop", "crash stop"}
    np.testing.assert_allclose(lines["crash stop"][0], [0.0, 1.0])
    assert lines["crash stop"][-1, 0] == pytest.approx(10.0, abs=2 * SAMPLE_S)
    assert np.all(lines["crash stop"][:-1, 1] >= -1e-9)
    np.testing.assert_allclose(lines["coasting stop"][-1], [END_S - BEGIN_S, 1.0 - 5.0])


def test_a_crash_stop_that_never_goes_astern_is_shown_whole(plot):
    slow = move(surge=1.0 / (1.0 + LATER_S))
    (line,) = read_lines(plot({"crash stop": slow})["stop"]).values()
    np.testing.assert_allclose(line[-1], [END_S - BEGIN_S, 1.0 / 51.0])


def test_a_zigzag_is_shown_to_a_tenth_beyond_its_fourth_reversal_or_whole(plot):
    """Reversals every 5 s: the fourth is 20 s after the steering began."""
    heading = np.radians(10.0) * np.sin(np.pi * LATER_S / 10.0)
    many = np.where((LATER_S // 5.0) % 2, -1.0, 1.0)
    few = np.where((LATER_S >= 5.0) & (LATER_S < 10.0), -1.0, 1.0)
    motions = {
        "zig-zag 10/10": move(yaw_rad=heading, steering=many),
        "zig-zag 20/20": move(yaw_rad=heading, steering=few),
    }
    lines = read_lines(plot(motions)["zig-zag"])
    assert set(lines) == {"10/10", "20/20"}
    assert lines["10/10"][-1, 0] == pytest.approx(22.0, abs=3 * SAMPLE_S)
    assert lines["20/20"][-1, 0] == pytest.approx(END_S - BEGIN_S)
    time_s, angle_deg = lines["20/20"].T
    np.testing.assert_allclose(angle_deg, 10.0 * np.sin(np.pi * time_s / 10.0), atol=1e-9)


def test_an_empty_panel_states_the_reason_in_its_middle(plot):
    panels = plot(
        {}, {"crash stop": "no actuator pushes in surge", "roll decay": "held by --level"}
    )
    assert set(panels) == {
        "turning circle",
        "zig-zag",
        "spiral",
        "stop",
        "full push from rest",
        "free decay",
    }
    assert [text.get_text() for text in panels["stop"].texts] == [
        "not done\nno actuator pushes in surge"
    ]
    assert [text.get_text() for text in panels["free decay"].texts] == ["not done\nheld by --level"]
    for axes in panels.values():
        (text,) = axes.texts
        box, panel = text.get_window_extent(), axes.get_window_extent()
        middle = [(box.x0 + box.x1) / 2, (box.y0 + box.y1) / 2]
        np.testing.assert_allclose(
            middle, [(panel.x0 + panel.x1) / 2, (panel.y0 + panel.y1) / 2], atol=2.0
        )


@pytest.mark.parametrize("level", [False, True])
def test_the_headline_states_whether_roll_and_pitch_are_held(plot, level):
    figure = plot({}, level=level)["stop"].figure
    title, subtitle = (text.get_text() for text in figure.texts)
    assert title == "Sea trials of simple"
    assert ("roll and pitch held" in subtitle) == level
