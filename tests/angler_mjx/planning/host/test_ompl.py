"""OMPL's planners, judged by closed forms written here."""

import pickle
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.planning.answers import check_answer
from angler_mjx.planning.host.ompl.planners import PLANNERS
from angler_mjx.planning.planner import NoPlan

from ..problems import problem

pytest.importorskip("ompl", reason="needs the extra plan: OMPL")
pytest.importorskip("numba", reason="needs the extra plan: numba")
from angler_mjx.planning.host.edges import EdgeChecker
from angler_mjx.planning.host.ompl.shortcut import build_smoothing_problem
from angler_mjx.planning.host.ompl.straightening import shortest_through_points

WALL = (5, slice(0, 7), slice(None))
"""Of a cube of ten cells: open where y is above 7 m."""

RADIUS = 0.3


def plan(name, asked, **settings):
    kind = PLANNERS[name]
    planner = kind(kind.Settings(**settings))
    begin = time.perf_counter()
    paths = planner.plan(asked)
    taken = time.perf_counter() - begin
    return check_answer(
        paths, asked, taken, planner.extras, planner.settings.points, planner.progress
    )


def at(path, when):
    """Places [n, 3] at times [n]; held after the last."""
    return np.stack([np.interp(when, path.time_s, path.position_m[:, n]) for n in range(3)], -1)


def box_gap(p, low, high):
    """Distance of points [n, 3] to a box."""
    outside = np.maximum(np.maximum(np.subtract(low, p), np.subtract(p, high)), 0.0)
    return np.linalg.norm(outside, axis=-1)


def least_between(one, other):
    """Least distance of two robots over all time, exactly: a minimum of each piece."""
    when = np.unique(np.concatenate([one.time_s, other.time_s]).astype(float))
    apart = at(one, when) - at(other, when)
    a, d = apart[:-1], np.diff(apart, axis=0)
    share = np.clip(-(a * d).sum(-1) / np.maximum((d * d).sum(-1), 1e-12), 0.0, 1.0)
    return np.linalg.norm(a + share[:, None] * d, axis=-1).min()


def fine(path):
    return np.linspace(0.0, path.time_s[-1], 2000)


ONE = problem([(2, 2, 2)], [(8, 2, 2)], rock=[WALL], deadline_s=1.0)


@pytest.fixture(scope="module", autouse=True)
def _compiled():
    kind = PLANNERS["RRTConnect"]
    kind(kind.Settings()).warm_up(ONE)


@pytest.mark.parametrize("name", PLANNERS)
def test_every_planner_goes_around_a_wall(name):
    got = plan(name, ONE, first=True, time_limit_s=0.5)
    assert got.status == "planned", got.reason
    (path,) = got.paths
    np.testing.assert_allclose(path.position_m[[0, -1]], [(2, 2, 2), (8, 2, 2)], atol=1e-6)
    places = at(path, fine(path))
    assert box_gap(places, (5, 0, 0), (6, 7, 10)).min() > RADIUS
    assert places.min() > RADIUS
    assert places.max() < 10 - RADIUS
    told = got.extras
    assert 0 < told["first_s"] <= told["best_s"] <= told["search_s"]
    assert got.progress[0][0] == told["first_s"]
    assert got.progress[-1] == (told["best_s"], told["best_cost"])


@pytest.mark.parametrize("name", PLANNERS)
def test_what_cannot_be_found_ends_by_its_limit_and_not_by_the_deadline(name):
    shut = problem([(2, 2, 2)], [(8, 2, 2)], rock=[(5, slice(None), slice(None))], deadline_s=5.0)
    got = plan(name, shut, time_limit_s=0.15)
    assert got.status == "none"
    assert got.reason.startswith("no way found in 0.")
    assert got.planning_s < 2.5


def test_a_search_leaves_time_to_hand_over_its_plan_before_the_deadline():
    shut = problem([(2, 2, 2)], [(8, 2, 2)], rock=[(5, slice(None), slice(None))], deadline_s=1.0)
    got = plan("RRTstar", shut)
    limit_s = float(got.reason.removeprefix("no way found in ").removesuffix(" s"))
    assert 0.8 < limit_s < 0.9 * 0.995  # nine tenths search, the rest straightens


@pytest.mark.parametrize("name", ["AORRTC", "BITstar", "InformedRRTstar", "PRMstar", "SORRTstar"])
@pytest.mark.parametrize("robots", [1, 2])
def test_a_search_that_found_the_straight_line_ends_long_before_its_limit(name, robots):
    starts, goals = [(2, 2, 2), (2, 7, 7)], [(8, 2, 2), (8, 7, 6)]
    free = problem(starts[:robots], goals[:robots], deadline_s=30.0)
    got = plan(name, free, simplify="none")
    assert got.status == "planned", got.reason
    assert got.extras["search_s"] < 15.0
    line = np.linalg.norm(np.subtract(goals[:robots], starts[:robots]))
    assert got.extras["best_cost"] == pytest.approx(line, rel=1e-5)


@pytest.mark.parametrize(
    ("name", "edges"),
    [("RRTConnect", 1000), ("AORRTC", 1000), ("BITstar", 600), ("FMT", 3000), ("LBKPIECE1", 1000)],
)
def test_the_same_seed_is_the_same_plan_and_another_is_another(name, edges):
    limit = {"edge_limit": edges, "simplify": "none"}
    first, again = (plan(name, ONE, **limit).paths[0] for _ in range(2))
    other = plan(name, replace(ONE, seed=np.uint32(8)), **limit).paths[0]
    np.testing.assert_array_equal(first.position_m, again.position_m)
    np.testing.assert_array_equal(first.time_s, again.time_s)
    assert not np.array_equal(first.position_m, other.position_m)


GAP = [(5, slice(0, 4), slice(None)), (5, slice(6, None), slice(None))]
"""A gap from y = 4 to 6 m: too narrow for two who do not make way."""
SWAP = problem([(2, 5, 5), (8, 5, 5)], [(8, 5, 5), (2, 5, 5)], rock=GAP, deadline_s=5.0, radius=0.4)


@pytest.mark.parametrize("mode", ["composite", "prioritised"])
@pytest.mark.parametrize("simplify", ["shortcut", "ompl", "none"])
def test_two_who_swap_places_in_a_gap_never_meet(mode, simplify):
    got = plan("RRTConnect", SWAP, mode=mode, simplify=simplify, time_limit_s=0.5)
    assert got.status == "planned", got.reason
    one, other = got.paths
    assert least_between(one, other) > 0.8
    for path in got.paths:
        places = at(path, fine(path))
        assert min(box_gap(places, (5, 0, 0), (6, 4, 10)).min(), 10) > 0.4
        assert box_gap(places, (5, 6, 0), (6, 10, 10)).min() > 0.4
        speed = np.linalg.norm(np.diff(path.position_m, axis=0), axis=1) / np.diff(path.time_s)
        assert speed.max() < 0.5 * 1.01


def test_composite_robots_are_as_fast_as_the_slowest_needs():
    asked = problem([(2, 2, 2), (2, 6, 2)], [(8, 2, 2), (4, 6, 2)])
    one, other = plan("RRTConnect", asked).paths
    assert one.time_s[-1] == pytest.approx(6.0 / 0.5, rel=5e-3)
    assert other.time_s[-1] == one.time_s[-1]


def test_one_by_one_earlier_robots_keep_their_ways():
    """The first goes straight, as if alone; who comes later makes way."""
    ends = [(2, 5, 5), (5, 2, 5)], [(8, 5, 5), (5, 8, 5)]
    first, later = plan("RRTConnect", problem(*ends), mode="prioritised").paths
    alone = plan("RRTConnect", problem(ends[0][:1], ends[1][:1])).paths[0]
    np.testing.assert_array_equal(first.position_m, alone.position_m)
    np.testing.assert_array_equal(first.time_s, alone.time_s)
    assert least_between(first, later) > 2 * RADIUS
    # Both would be in the middle after 6 s.
    assert later.time_s[-1] > first.time_s[-1] + 1.0


@pytest.mark.parametrize("drifting", [False, True])
def test_one_by_one_nobody_passes_where_an_earlier_arrival_stands(drifting):
    """The second's goal is on the first's way, and it cannot wait until the first has passed."""
    far = {"radius_m": [0.1], "p_m": [[(0.5, 9.5, 0.5), (0.5, 9.5, 9.5)]], "time_s": [0.0, 60.0]}
    asked = problem(
        [(1, 5, 5), (8, 1, 5)],
        [(9, 5, 5), (8, 5, 5)],
        radius=0.45,
        horizon_s=16.1,
        obstacles=far if drifting else None,
    )
    got = plan("RRTConnect", asked, mode="prioritised", time_limit_s=0.5)
    first, second = got.paths
    assert not isinstance(first, NoPlan) or not isinstance(second, NoPlan)
    if not isinstance(first, NoPlan) and not isinstance(second, NoPlan):
        assert least_between(first, second) > 0.9


def test_a_current_slows_robots_down_by_what_it_takes():
    against = problem([(2, 2, 2)], [(8, 2, 2)], current=(-0.5, 0, 0))
    path = plan("RRTConnect", against).paths[0]
    # Of 1 m/s through the water 0.8 may be used: 0.3 over ground, of 0.5.
    assert path.time_s[-1] == pytest.approx(6.0 / 0.3, rel=5e-3)
    across = problem([(2, 2, 2)], [(8, 2, 2)], current=(0, 0.75, 0))
    path = plan("RRTConnect", across).paths[0]
    assert path.time_s[-1] == pytest.approx(6.0 / np.sqrt(0.8**2 - 0.75**2), rel=5e-3)
    too_strong = problem([(2, 2, 2)], [(8, 2, 2)], current=(-0.9, 0, 0))
    got = plan("RRTConnect", too_strong, time_limit_s=0.3)
    assert got.reason.startswith("the current is too strong for robot 0 at (2.0, 2.0, 2.0) m")


CROSSING = {
    "radius_m": [0.5],
    "time_s": [0.0, 10.0],
    "p_m": [[(5, -3, 2), (5, 7, 2)]],
}
"""A ball that is on the straight way from (2, 2, 2) to (8, 2, 2) when a robot would be there."""


@pytest.mark.parametrize("mode", ["composite", "prioritised"])
def test_a_robot_waits_for_what_is_known_to_move(mode):
    asked = problem([(2, 2, 2)], [(8, 2, 2)], obstacles=CROSSING)
    ignoring = plan("RRTConnect", asked, mode=mode, moving="ignored").paths[0]
    waiting = plan("RRTConnect", asked, mode=mode)
    ball = replace(
        ignoring,
        time_s=np.array([0.0, 10.0]),
        position_m=np.array([(5, -3, 2), (5, 7, 2)], float),
    )
    assert least_between(ignoring, ball) < 0.8 < least_between(waiting.paths[0], ball)
    assert waiting.extras["delay_s"] > 0
    np.testing.assert_array_equal(waiting.paths[0].position_m[:2], [(2, 2, 2)] * 2)


def test_headings_are_planned_where_they_are_asked_for():
    got = plan("RRTConnect", SWAP, heading=True)
    assert got.status == "planned", got.reason
    path = got.paths[0]
    assert path.position.shape[1] == 4
    np.testing.assert_allclose(path.position[[0, -1], 3], 0.0, atol=1e-6)
    turn = np.abs(np.diff(path.position[:, 3])) / np.diff(path.time_s)
    assert turn.max() < 0.5 * 1.01


@pytest.mark.parametrize(
    ("asked", "reasons"),
    [
        (
            problem([(5.5, 2, 2), (2, 2, 2)], [(8, 2, 2), (2, 8, 2)], rock=[WALL]),
            ["its start is taken or outside", "robot 0 has no way: its start is taken or outside"],
        ),
        (
            problem([(2, 2, 2), (2, 6, 2)], [(8, 2, 2), (0.1, 6, 2)]),
            ["robot 1 has no way: its goal is taken or outside", "its goal is taken or outside"],
        ),
        (
            problem([(2, 2, 2), (2, 2.5, 2)], [(8, 2, 2), (8, 6, 2)]),
            ["robots overlap at their starts"] * 2,
        ),
        (
            problem([(2, 2, 2)], [(8, 2, 2)], horizon_s=11.0),
            ["the way takes 12 s of 11 s"],
        ),
    ],
)
def test_what_cannot_be_planned_is_said(asked, reasons):
    got = plan("RRTConnect", asked, time_limit_s=0.2)
    assert got.paths == [NoPlan(reason) for reason in reasons]


def test_one_by_one_a_robot_without_a_way_costs_only_its_own():
    asked = problem([(5.5, 2, 2), (2, 2, 2)], [(8, 2, 2), (2, 8, 2)], rock=[WALL])
    got = plan("RRTConnect", asked, mode="prioritised", time_limit_s=0.5)
    assert got.status == "partial"
    assert got.reason == "robot 0: its start is taken or outside"


@pytest.mark.parametrize(
    ("name", "settings", "says"),
    [
        ("RRT", {"goal_bias": 1.5}, "planner.RRT.goal_bias = 1.5: give 0 to 1"),
        ("BITstar", {"samples_per_batch": 0}, "samples_per_batch = 0: give at least 1"),
        ("PRM", {"edge_limit": 10}, "planner.PRM.edge_limit: it ends by the clock alone"),
        ("FMT", {"mode": "both"}, "mode = 'both': give one of composite, prioritised"),
        ("FMT", {"points": 1}, "points = 1: give 2 to 1024"),
    ],
)
def test_settings_out_of_bounds_are_refused(name, settings, says):
    kind = PLANNERS[name]
    with pytest.raises(ConfigError, match=says.replace("(", r"\(")):
        kind(kind.Settings(**settings))


def test_parameters_reach_ompl():
    short = plan("RRTConnect", ONE, range_m=0.2, simplify="none")
    long = plan("RRTConnect", ONE, range_m=8.0, simplify="none")
    assert short.extras["edges"] > 2 * long.extras["edges"]


@pytest.mark.parametrize("name", ["RRTstar", "BITstar", "AORRTC"])
def test_each_better_path_is_told_of(name):
    got = plan(name, ONE, time_limit_s=0.4, simplify="none")
    when, cost = np.array(got.progress).T
    assert 2 <= len(when) <= 1000
    assert (np.diff(when) >= 0).all()
    assert (np.diff(cost) < 0).all()
    way = np.linalg.norm(np.diff(got.paths[0].position_m, axis=0), axis=1).sum()
    assert way == pytest.approx(cost[-1], rel=1e-4)
    # Nothing that keeps 0.3 m from the wall's edge at y = 7 is shorter than past that corner.
    assert cost[-1] >= 2 * np.hypot(2.5, 5.0)


@pytest.mark.parametrize("simplify", ["none", "ompl"])
@pytest.mark.parametrize(("asked", "most"), [(ONE, 12), (SWAP, 8)], ids=["one", "two"])
def test_a_path_of_too_many_points_is_thinned_to_what_can_be_flown(asked, most, simplify):
    """The way past the wall needs three edges; that of two who swap a few more."""
    many = plan("RRTConnect", asked, range_m=0.2, simplify=simplify, points=1024)
    assert simplify == "ompl" or max(len(path.time_s) for path in many.paths) > most
    got = plan("RRTConnect", asked, range_m=0.2, simplify=simplify, points=most)
    assert got.status == "planned", got.reason
    wall = [((5, 0, 0), (6, 7, 10))]
    if asked is SWAP:
        wall = [((5, 0, 0), (6, 4, 10)), ((5, 6, 0), (6, 10, 10))]
        assert least_between(*got.paths) > 0.8
    radius = float(asked.team.radius_m[0])
    for path, end in zip(got.paths, asked.team.goal_m, strict=True):
        assert len(path.time_s) <= most
        np.testing.assert_allclose(path.position_m[-1], end, atol=1e-6)
        places = at(path, fine(path))
        assert min(box_gap(places, *box).min() for box in wall) > radius


def quickest(path, edges, speed):
    """Least time of the slowest robot, and a tenth of the mean, through points of a path.

    Each edge is looked at; the least is relaxed until nothing changes.
    """
    count = len(path)
    price = np.full((count, count), np.inf)
    for i in range(count):
        for j in range(i + 1, count):
            took = np.linalg.norm(path[j] - path[i], axis=-1) / speed
            if j == i + 1 or edges(path[i][None], path[j][None])[0]:
                price[i, j] = took.max() + 0.1 * took.mean()
    least = np.where(np.arange(count) == 0, 0.0, np.inf)
    for _ in range(count):
        least = np.minimum(least, (least[:, None] + price).min(axis=0))
    return least[-1]


@pytest.mark.parametrize("robots", [1, 3])
def test_the_way_through_points_is_the_quickest_there_is(robots):
    """Of a random walk of a team among rock, against every edge of it looked at."""
    rng = np.random.default_rng(robots)
    asked = problem([(2, 2 + 2 * n, 2) for n in range(robots)], [(8, 2, 2)] * robots, rock=[WALL])
    checks, speed = EdgeChecker(asked), rng.uniform(0.3, 1.0, robots)
    walk = [np.array(asked.team.start_m, float)]
    while len(walk) < 20:
        step = walk[-1] + rng.normal(0.0, 1.2, (robots, 3))
        if checks.edge(walk[-1], step):
            walk.append(step)
    walk = np.array(walk)
    got = shortest_through_points(build_smoothing_problem(checks), walk, speed)
    took = np.linalg.norm(np.diff(got, axis=0), axis=-1) / speed
    assert checks.edges(got[:-1], got[1:]).all()
    assert (took.max(axis=1) + 0.1 * took.mean(axis=1)).sum() == pytest.approx(
        quickest(walk, checks.edges, speed), rel=1e-12
    )


COUNT = """
import gc, sys
sys.path.insert(0, sys.argv[1])
from angler_mjx.planning.host.ompl.planners import PLANNERS
from numba.core.dispatcher import Dispatcher
from tests_of_planning import asked

planner = PLANNERS["RRTConnect"](PLANNERS["RRTConnect"].Settings(mode=sys.argv[2]))
planner.warm_up(asked[0])
made = lambda: {(d.__name__, s) for d in gc.get_objects() if isinstance(d, Dispatcher)
                for s in d.signatures}
before = made()
for problem in asked[1:]:
    planner.plan(problem)
print(*(name for name, _ in made() - before))
"""


@pytest.mark.parametrize("mode", ["composite", "prioritised"])
def test_all_is_compiled_before_the_clock_starts(mode, tmp_path):
    """Warmed up where every way is straight and free; then asked for ways around a wall."""
    easy = problem([(2, 2, 2), (2, 6, 2)], [(8, 2, 2), (8, 6, 2)])
    hard = problem([(2, 2, 2), (2, 6, 2)], [(8, 2, 2), (8, 6, 2)], rock=[WALL])
    data = pickle.dumps([easy, hard, SWAP])
    text = f"import pickle\nasked = pickle.loads({data!r})\n"
    (tmp_path / "tests_of_planning.py").write_text(text)
    done = subprocess.run(
        [sys.executable, "-c", COUNT, str(tmp_path), mode],
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.split() == []
