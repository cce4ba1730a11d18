"""Obstacles of scenarios with contact: pieces of long capsules, and what is refused."""

import itertools

import pytest

from angler_mjx.scenario.contact_table import ContactConfig, check_bodies, cut_axes
from angler_mjx.world.config import WorldConfig

CELL_M = 1.5
"""Of the preset, which is 24 m wide and ends 2 m below the surface."""
DRIFT = {"type": "drift"}


def lay_out(*items):
    """Return a world with obstacles."""
    return WorldConfig.model_validate({"preset": "open", "obstacles": {"explicit": list(items)}})


def capsule(length_m, radius_m=0.1, motion=DRIFT, position_m=(0.0, 0.0, -12.0)):
    """Return the table of a capsule."""
    return {
        "type": "capsule",
        "radius_m": radius_m,
        "length_m": length_m,
        "position_m": list(position_m),
        "motion": motion,
    }


BALL = {"type": "sphere", "radius_m": 0.3, "position_m": [9.0, 9.0, -12.0], "motion": DRIFT}


def test_axes_are_cut_where_a_drifting_capsule_is_long():
    assert cut_axes(lay_out(BALL, capsule(2.79))) == ()
    assert cut_axes(lay_out(BALL, capsule(2.81))) == (1, 2)
    assert cut_axes(lay_out(capsule(3.0), BALL)) == (2, 1)
    assert cut_axes(lay_out(capsule(3.0, motion={"type": "static"}), BALL)) == (0, 1)
    assert ContactConfig().spec(0.005, lay_out(capsule(7.0), BALL)).axis_pieces == (6, 1)
    assert ContactConfig().spec(0.005, lay_out(BALL)).axis_pieces == ()


@pytest.mark.parametrize(
    ("length", "radius"),
    list(itertools.product([2.98, 3.0, 4.4, 6.0, 9.1, 12.0], [0.02, 0.3, 1.0, 1.3])),
)
def test_pieces_are_as_short_as_the_search_for_rock_needs(length, radius):
    (count,) = cut_axes(lay_out(capsule(length, radius)))
    assert count % 2 == 0
    assert length / count <= CELL_M
    assert 0.5 * length / count + radius < CELL_M


def test_long_capsules_are_accepted():
    check_bodies(lay_out(capsule(3.0), BALL))
    check_bodies(lay_out(capsule(19.0)))
    long = capsule(40.0, motion={"type": "static"}, position_m=(11.0, 0.0, -4.0))
    long["rpy_deg"] = [0.0, 90.0, 0.0]
    check_bodies(lay_out(long))


@pytest.mark.parametrize(
    ("item", "words"),
    [
        (capsule(1.0, 1.5), r"explicit\[0\].radius_m = 1.5.*drifting capsule.*cell_m = 1.5"),
        (BALL | {"radius_m": 1.6}, r"explicit\[0\].radius_m = 1.6.*drifting sphere.*1.5"),
        (capsule(3.0, position_m=(10.5, 0, -12)), r"explicit\[0\].position_m.*1.6 m.*1.5 m from"),
        (capsule(3.0, position_m=(0, 0, -3.5)), r"explicit\[0\].position_m.*1.6 m.*top.*1.5 m"),
        (capsule(24.0), r"explicit\[0\].position_m.*reaches 12.1 m"),
    ],
)
def test_bodies_that_cannot_be_simulated_are_refused_by_name(item, words):
    with pytest.raises(ValueError, match=f"(?s){words}"):
        check_bodies(lay_out(item))
    still = item | {"motion": {"type": "static"}}
    if item["position_m"][2] - item["radius_m"] - 0.5 * item.get("length_m", 0.0) > -26.0:
        check_bodies(lay_out(still))


def test_overlaps_at_the_start_are_refused_by_name():
    near = BALL | {"position_m": [9.3, 9.0, -12.0]}
    with pytest.raises(ValueError, match=r"explicit\[0\].*explicit\[1\].*overlap by 0.3"):
        check_bodies(lay_out(BALL, near))
