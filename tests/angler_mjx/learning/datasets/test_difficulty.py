"""How hard an episode is: straight lines that cross, and rock that lies in them."""

import numpy as np
import pytest

from angler_mjx.learning.datasets import index
from angler_mjx.learning.datasets.sampling import DIFFICULTIES


def lines(*pairs):
    """Starts and goals [1, r, 3] of robots, given as start and goal each."""
    return (np.array([[pair[i] for pair in pairs]], np.float32) for i in range(2))


CASES = {
    "opposite ways on one line": ([((0, 0, 0), (9, 0, 0)), ((9, 0, 0), (0, 0, 0))], 1),
    "across in the middle": ([((0, 0, 0), (9, 9, 0)), ((9, 0, 0), (0, 9, 0))], 1),
    "over each other, far": ([((0, 0, 0), (9, 9, 0)), ((9, 0, 1.6), (0, 9, 1.6))], 0),
    "over each other, near": ([((0, 0, 0), (9, 9, 0)), ((9, 0, 1.4), (0, 9, 1.4))], 1),
    "side by side": ([((0, 0, 0), (9, 0, 0)), ((0, 1.2, 0), (9, 1.2, 0))], 0),
    "side by side, coming nearer": ([((0, 0, 0), (9, 0, 0)), ((0, 1.4, 0), (9, 1.0, 0))], 0),
    "side by side, changing sides": ([((0, 0, 0), (9, 1, 0)), ((0, 1, 0), (9, 0, 0))], 1),
    "past the other's start": ([((0, 0, 0), (0, 9, 0)), ((-5, 1, 0), (5, 1, 0))], 1),
    "in a row": ([((0, 0, 0), (9, 0, 0)), ((-2, 0, 0), (7, 0, 0))], 1),
}


@pytest.mark.parametrize("name", CASES)
def test_lines_cross_where_robots_come_nearer_than_at_their_ends(name):
    robots, crossings = CASES[name]
    assert index.count_crossings(*lines(*robots)).tolist() == [crossings]


def test_no_pair_is_left_out():
    """Eight robots from the corners of a cube to the opposite ones: all meet in the middle."""
    corners = np.array(list(np.ndindex(2, 2, 2)), np.float32)[None] * 20.0
    assert index.count_crossings(corners, 20.0 - corners).tolist() == [28]
    aside = corners + np.array([10.0, 0.0, 0.0], np.float32)
    assert index.count_crossings(corners, aside).tolist() == [0]


@pytest.mark.parametrize(
    ("robots", "free", "crossings", "level"),
    [
        (4, 4, 0, "trivial"),
        (4, 3, 0, "blocked"),
        (4, 0, 0, "blocked"),
        (4, 4, 1, "crossing"),
        (4, 2, 6, "crossing"),
        (4, 1, 6, "both"),
        (4, 0, 1, "both"),
        (3, 2, 1, "crossing"),
        (3, 1, 1, "both"),
        (1, 1, 0, "trivial"),
        (1, 0, 0, "blocked"),
    ],
)
def test_levels_tell_episodes_apart(robots, free, crossings, level):
    assert level in DIFFICULTIES
    assert index.classify_difficulty(np.array([free]), np.array([crossings]), robots).tolist() == [
        level
    ]
