"""States and swept edges of teams of balls, judged by coal and in closed form."""

import numpy as np
import pytest

pytest.importorskip("numba", reason="needs the extra plan (numba)")
pytest.importorskip("coal", reason="needs the extra plan (coal)")

from dataclasses import replace

from angler_mjx.errors import ConfigError
from angler_mjx.planning.host.compiled.packed import SLACK_M
from angler_mjx.planning.host.edges import EdgeChecker

from . import scenes

# Balls of 0.4, 0.3 and 0.5 m; and of those that are larger than a cell.
TEAMS = {"small": (1.0, 0.8, 1.2), "wide": (3.5, 1.0)}


@pytest.fixture(scope="module", params=TEAMS)
def world(request):
    share = 0.07 if request.param == "small" else 0.01
    return scenes.reef(5, TEAMS[request.param], share=share)


@pytest.fixture(scope="module")
def checker(world):
    return EdgeChecker(world)


@pytest.fixture(scope="module")
def judge(world):
    return scenes.Judge(world)


def some_edges(world, checker, n, seed=0):
    """Edges of 0 to 3 m from free states, and some from anywhere to anywhere; [m, R, 3]."""
    rng = np.random.default_rng(seed)
    free = scenes.places(world, rng, 40 * n)
    free = free[checker.states(free)][:n]
    assert len(free) > n // 4
    far = scenes.places(world, rng, n // 4), scenes.places(world, rng, n // 4)
    return np.concatenate([free, far[0]]), np.concatenate(
        [scenes.steps(rng, free, 0.0, 3.0), far[1]]
    )


def test_no_edge_is_called_free_that_touches_and_none_hit_that_is_clear(world, checker, judge):
    a, b = some_edges(world, checker, 800)
    free = checker.edges(a, b)
    assert 0.05 < free.mean() < 0.95
    assert not judge.touches(a[free], b[free]).any()
    assert judge.touches(a[~free], b[~free], more=2.0 * SLACK_M).all()


@pytest.mark.nightly(by="test_no_edge_is_called_free_that_touches_and_none_hit_that_is_clear")
def test_of_a_million_edges_none_is_called_free_that_touches():
    world = scenes.reef(11, (0.8, 0.8, 0.6, 0.6), n=16, share=0.06, cell_m=1.5)
    checker, judge, asked, called = EdgeChecker(world), scenes.Judge(world), 0, 0
    for seed in range(10):
        a, b = some_edges(world, checker, 80_000, seed)
        free = checker.edges(a, b)
        asked, called = asked + len(a), called + free.sum()
        assert not judge.touches(a[free], b[free]).any()
    assert asked == 1_000_000
    assert called > 100_000


def test_one_by_one_and_many_at_once_say_the_same(world, checker):
    a, b = some_edges(world, checker, 200)
    many = checker.edges(a, b)
    assert [checker.edge(p, q) for p, q in zip(a, b, strict=True)] == list(many)
    flat = [checker.edge_flat(p.reshape(-1), q.reshape(-1)) for p, q in zip(a, b, strict=True)]
    assert flat == list(many)
    assert [checker.state(p) for p in a] == list(checker.states(a))
    lists = checker.edge(a[0].astype(np.float32).tolist(), a[0].astype(np.float32).tolist())
    assert lists == checker.state(a[0].astype(np.float32))


def test_the_way_back_is_as_free_as_the_way_there(world, checker):
    a, b = some_edges(world, checker, 2000)
    assert (checker.edges(a, b) == checker.edges(b, a)).all()


def test_states_of_free_edges_are_free(world, checker):
    a, b = some_edges(world, checker, 1500)
    free = checker.edges(a, b)
    for share in np.linspace(0.0, 1.0, 33):
        assert (checker.clearances(a + share * (b - a))[free] >= SLACK_M - 1e-12).all()


def test_a_state_is_free_where_its_clearance_is(world, checker):
    p = scenes.places(world, np.random.default_rng(2), 4000)
    assert (checker.states(p) == (checker.clearances(p) > SLACK_M)).all()
    assert (checker.edges(p, p) == checker.states(p)).all()


def test_a_larger_margin_frees_nothing(world, checker):
    a, b = some_edges(world, checker, 1000)
    free = checker.edges(a, b)
    for margin in (0.05, 0.3):
        wider = EdgeChecker(world, margin_m=margin).edges(a, b)
        assert not (wider & ~free).any()
        assert wider.sum() < free.sum()
        free = wider


def test_a_part_of_the_team_is_looked_at_alone(world, checker, judge):
    a, b = some_edges(world, checker, 300)
    one = EdgeChecker(world, robots=[1])
    expected = [not judge.touches_world(1, p[1], q[1]) for p, q in zip(a, b, strict=True)]
    # Where coal and the check differ by their slack is met in no one of these edges.
    assert list(one.edges(a[:, 1:2], b[:, 1:2])) == expected


def open_water(scale=(1.0,), **more):
    return scenes.problem(np.zeros((10, 10, 10)), cell_m=2.0, scale=scale, **more)


def test_two_robots_meet_where_the_closed_form_says():
    world = open_water((1.0, 1.7))
    rng = np.random.default_rng(3)
    a = rng.uniform(4.0, 16.0, (4000, 2, 3))
    b = scenes.steps(rng, a, 0.0, 3.0)
    apart = scenes.Judge(world).pairs_apart(a, b)
    assert (EdgeChecker(world).edges(a, b) == (apart > SLACK_M)).all()
    assert (EdgeChecker(world, margin_m=0.7).edges(a, b) == (apart > 0.7 + SLACK_M)).all()


def test_robots_that_swap_places_meet_and_those_that_follow_do_not():
    checker = EdgeChecker(open_water((1.0, 1.0)))
    left, right, far = ([5.0, 5.0, 5.0], [7.0, 5.0, 5.0], [9.0, 5.0, 5.0])
    assert not checker.edge([left, right], [right, left])
    assert checker.edge([left, right], [right, far])


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("upper", [False, True])
def test_balls_stay_within_the_faces_of_the_cube(axis, upper):
    world = open_water()
    r = float(world.team.radius_m[0])
    for gap, free in ((2.0 * SLACK_M, True), (-2.0 * SLACK_M, False)):
        p = np.full((1, 3), 10.0)
        p[0, axis] = 20.0 - r - gap if upper else r + gap
        checker = EdgeChecker(world)
        assert checker.state(p) is free
        assert checker.edge(np.full((1, 3), 10.0), p) is free
        assert checker.clearance(p) == pytest.approx(gap, abs=1e-12)


def test_the_floor_cuts_the_cube_off():
    world = open_water(floor_z_m=3.0)
    checker, r = EdgeChecker(world), float(world.team.radius_m[0])
    assert checker.clearance([[10.0, 10.0, 3.0 + r + 0.2]]) == pytest.approx(0.2)
    assert not checker.edge([[10.0, 10.0, 5.0]], [[10.0, 10.0, 3.0 + r - 0.01]])
    assert EdgeChecker(open_water()).edge([[10.0, 10.0, 5.0]], [[10.0, 10.0, 3.0]])


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf, 1e300])
def test_what_is_no_place_is_never_free(checker, world, wrong):
    p = scenes.places(world, np.random.default_rng(0), 2000)
    good = p[checker.states(p)][0]
    bad = good.copy()
    bad[1, 2] = wrong
    assert checker.state(good)
    assert not checker.state(bad)
    assert not checker.edge(good, bad)
    assert not checker.edge(bad, good)


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"margin_m": -0.1}, "margin_m = -0.1"),
        ({"margin_m": float("nan")}, "margin_m = nan"),
        ({"robots": [0, 7]}, "robots = "),
        ({"robots": []}, "robots = "),
        ({"moving": "gone"}, "moving = 'gone'"),
    ],
)
def test_settings_that_mean_nothing_are_refused(world, settings, said):
    with pytest.raises(ConfigError, match=said):
        EdgeChecker(world, **settings)


def test_a_problem_with_numbers_that_are_none_is_refused(world):
    team = replace(world.team, radius_m=np.full(world.robots, np.nan))
    with pytest.raises(ConfigError, match="not finite"):
        EdgeChecker(replace(world, team=team))


def test_a_place_for_another_number_of_robots_is_refused(checker):
    with pytest.raises(ValueError, match="reshape"):
        checker.edge(np.zeros((7, 3)), np.zeros((7, 3)))
