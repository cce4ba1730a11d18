"""What is proved to be unsolvable is so by construction, and nothing else is."""

from types import SimpleNamespace

import numpy as np
import pytest

from angler_mjx.planning.priority.proofs import prove_unsolvable

from .test_grid import make_world

FREE = [(0, 0, 0), (0, 4, 0)], [(7, 0, 0), (7, 4, 0)]


def asked(rock, starts, goals, horizon_s=60.0, radius=0.4):
    world = make_world(rock, starts, goals)
    team = SimpleNamespace(
        start_m=world.start_m,
        goal_m=world.goal_m,
        radius_m=np.full(2, radius, np.float32),
        cruise_speed_mps=np.full(2, 0.5, np.float32),
    )
    return SimpleNamespace(grid=world.grid, team=team, horizon_s=horizon_s)


def walled(gate=None):
    rock = np.zeros((8, 5, 4), bool)
    rock[4] = True
    if gate:
        rock[gate] = False
    return rock


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({}, None),
        ({"rock": walled((4, 2, 2))}, None),
        ({"rock": walled()}, "robot 0 has rock"),
        ({"starts": [(0, 0, 0), (0, 0, 0)]}, "starts of robots 0 and 1"),
        ({"goals": [(7, 0, 0), (7, 0, 1)], "radius": 0.71}, "goals of robots 0 and 1"),
        ({"goals": [(7, 0, 0), (7, 0, 1)], "radius": 0.69}, None),
        ({"horizon_s": 20.5}, "robot 0 needs 21 s"),
        ({"horizon_s": 21.5}, None),
    ],
)
def test_proofs(change, why):
    problem = asked(
        **{"rock": np.zeros((8, 5, 4), bool), "starts": FREE[0], "goals": FREE[1]} | change
    )
    found = prove_unsolvable(problem, margin_m=0.1)
    assert (found is None) if why is None else found.startswith(why)


def test_cells_that_share_only_an_edge_are_not_joined():
    """Two halves of a wall that stand a cell apart leave an edge, through which nothing passes."""
    rock = np.ones((8, 5, 4), bool)
    rock[:4, 0, 0] = rock[4:, 1, 0] = False
    ways = [(0, 0, 0), (2, 0, 0)], [(7, 1, 0), (1, 0, 0)]
    assert prove_unsolvable(asked(rock, *ways), 0.1).startswith("robot 0 has rock")
    rock[4, 0, 0] = False
    assert prove_unsolvable(asked(rock, *ways), 0.1) is None
