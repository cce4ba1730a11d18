"""One robot in time among other robots' paths and moving obstacles."""

import numpy as np
import pytest

pytest.importorskip("numba", reason="needs the extra plan (numba)")
pytest.importorskip("coal", reason="needs the extra plan (coal)")

from angler_mjx.errors import ConfigError
from angler_mjx.planning.host.compiled.packed import SLACK_M
from angler_mjx.planning.host.edges import EdgeChecker
from angler_mjx.planning.host.timed import Traffic

from . import scenes

TIMES = np.array([0.0, 1.5, 2.0, 6.0, 9.0])
SIZE = 20.0


def path(rng, n):
    return rng.uniform(2.0, SIZE - 2.0, (n, 3))


@pytest.fixture(scope="module")
def world():
    rng = np.random.default_rng(4)
    return scenes.problem(
        np.zeros((10, 10, 10)),
        cell_m=SIZE / 10,
        scale=(1.0, 1.8),
        bodies=[
            scenes.body("sphere", (0.7, 0.0, 0.0), path(rng, len(TIMES)), moves=True),
            scenes.body("box", (0.5, 0.2, 0.9), path(rng, len(TIMES)), moves=True),
            scenes.body("capsule", (0.4, 0.6, 0.0), [10.0, 10.0, 10.0]),
        ],
        time_s=TIMES,
    )


@pytest.fixture(scope="module")
def checker(world):
    return EdgeChecker(world)


@pytest.fixture(scope="module")
def traffic():
    rng = np.random.default_rng(6)
    time = np.cumsum(rng.uniform(0.5, 3.0, (3, 6)), axis=1)
    place = np.stack([path(rng, 6) for _ in range(3)])
    time[2, 4:], place[2, 4:] = time[2, 3], place[2, 3]  # A shorter path, padded.
    return Traffic.of(time, place, np.array([0.4, 0.9, 0.2]))


def place_at(time_s, place, t):
    return np.stack([np.interp(t, time_s, place[:, k]) for k in range(3)], axis=-1)


def moving(world, traffic):
    known = world.obstacles
    yield from zip(traffic.time_s, traffic.position_m, traffic.radius_m, strict=True)
    for i in np.flatnonzero(known.moves):
        yield known.time_s, known.p_m[i], known.radius_m[i]


def some_edges(n):
    rng = np.random.default_rng(8)
    a = rng.uniform(1.0, SIZE - 1.0, (n, 3))
    t_a = rng.uniform(0.0, 14.0, n)
    return a, t_a, scenes.steps(rng, a, 0.0, 1.0), t_a + rng.uniform(0.0, 5.0, n)


def least_apart(world, traffic, robot, a, t_a, b, t_b, samples=600):
    """Least distance [n] to anything that moves, at samples."""
    least = np.full(len(a), np.inf)
    for s in np.linspace(0.0, 1.0, samples):
        p, t = a + s * (b - a), t_a + s * (t_b - t_a)
        for time, place, radius in moving(world, traffic):
            apart = np.linalg.norm(p - place_at(time, place, t), axis=1) - radius
            least = np.minimum(least, apart - world.team.radius_m[robot])
    return least


@pytest.mark.parametrize("robot", [0, 1])
def test_edges_in_time_meet_what_samples_of_them_meet(world, checker, traffic, robot):
    edges = some_edges(3000)
    free = checker.timed_edges(robot, *edges, traffic)
    still = EdgeChecker(world, robots=[robot]).edges(edges[0][:, None], edges[2][:, None])
    least = least_apart(world, traffic, robot, *edges)
    assert not (free & ~still).any()
    assert (least[free] > 0.0).all()
    # Between two samples nothing here comes 0.15 m nearer: 40 m/s at most, 8 ms.
    assert (least[still & ~free] < 0.15).all()
    assert 20 < (still & ~free).sum() < free.sum()


def test_one_by_one_says_the_same_as_many_at_once(checker, traffic):
    edges = some_edges(300)
    many = checker.timed_edges(0, *edges, traffic)
    assert [checker.timed_edge(0, *row, traffic) for row in zip(*edges, strict=True)] == list(many)


def test_an_edge_in_parts_is_free_where_its_parts_are(checker, traffic):
    a, t_a, b, t_b = some_edges(2000)
    whole = checker.timed_edges(0, a, t_a, b, t_b, traffic)
    m, t_m = 0.5 * (a + b), 0.5 * (t_a + t_b)
    first = checker.timed_edges(0, a, t_a, m, t_m, traffic)
    second = checker.timed_edges(0, m, t_m, b, t_b, traffic)
    assert (whole == (first & second)).all()


HERE, THERE = np.array([5.0, 5.0, 5.0]), np.array([9.0, 5.0, 5.0])


def crossing(time_s, radius_m=0.5):
    """One that goes through the middle of HERE and THERE from north to south."""
    way = [[7.0, 9.0, 5.0], [7.0, 1.0, 5.0]]
    return Traffic.of(np.array([time_s]), np.array([way]), np.array([radius_m]))


@pytest.fixture(scope="module")
def alone():
    return EdgeChecker(scenes.problem(np.zeros((10, 10, 10)), cell_m=2.0))


def test_whether_two_meet_is_a_matter_of_time(alone):
    assert not alone.timed_edge(0, HERE, 0.0, THERE, 4.0, crossing([0.0, 4.0]))
    assert alone.timed_edge(0, HERE, 0.0, THERE, 4.0, crossing([4.0, 8.0]))
    assert alone.timed_edge(0, HERE, 20.0, THERE, 24.0, crossing([0.0, 4.0]))


def test_closest_approach_is_that_of_the_closed_form(alone):
    # Both at 1 m/s and at right angles, 0.8 s apart at the crossing: 0.8 / sqrt(2) m at the least.
    r = float(alone.clearance([[10.0, 10.0, 10.0]]))
    own = 10.0 - r
    limit = 0.8 / np.sqrt(2.0) - own
    way = [[7.0, 9.0, 5.0], [7.0, 1.0, 5.0]]
    for more, free in ((-2.0 * SLACK_M, True), (2.0 * SLACK_M, False)):
        other = Traffic.of([[-1.2, 6.8]], [way], [limit + more])
        assert alone.timed_edge(0, HERE, 0.0, THERE, 4.0, other) is free


def test_robots_stand_before_their_first_time_and_after_their_last(alone):
    first, last = [7.0, 9.0, 5.0], [7.0, 1.0, 5.0]
    late = crossing([50.0, 54.0])
    assert not alone.timed_edge(0, first, 0.0, first, 10.0, late)
    assert alone.timed_edge(0, last, 0.0, last, 10.0, late)
    assert not alone.timed_edge(0, last, 60.0, last, 70.0, late)
    assert alone.timed_edge(0, first, 60.0, first, 70.0, late)


def test_one_who_stays_for_ever_is_looked_at_for_ever(alone):
    assert not alone.timed_edge(
        0, [7.0, 5.0, 5.0], 0.0, [7.0, 5.0, 5.0], np.inf, crossing([50, 54])
    )
    assert alone.timed_edge(0, [7.0, 5.0, 5.0], 54.0, [7.0, 5.0, 5.0], np.inf, crossing([50, 54]))
    assert not alone.timed_edge(0, HERE, 0.0, THERE, np.inf, Traffic.none())


def test_time_that_runs_back_or_is_none_is_never_free(alone):
    assert alone.timed_edge(0, HERE, 1.0, THERE, 2.0, Traffic.none())
    assert not alone.timed_edge(0, HERE, 2.0, THERE, 1.0, Traffic.none())
    assert not alone.timed_edge(0, HERE, np.nan, THERE, 1.0, Traffic.none())
    assert not alone.timed_edge(0, HERE, 1.0, [np.nan, 5.0, 5.0], 2.0, Traffic.none())


def test_a_jump_in_a_path_counts_all_of_its_way(alone):
    jump = Traffic.of(
        [[0.0, 2.0, 2.0, 4.0]],
        [[[5.0, 9.0, 5.0], [5.0, 9.0, 5.0], [5.0, 1.0, 5.0], [5.0, 1.0, 5.0]]],
        [0.1],
    )
    assert not alone.timed_edge(0, HERE, 1.0, HERE, 3.0, jump)
    assert alone.timed_edge(0, HERE, 2.1, HERE, 3.0, jump)


def test_obstacles_that_move_are_looked_at_in_time_alone_unless_they_are_to_stand(world):
    first = world.obstacles.p_m[0, 0]
    later = float(TIMES[-1]) + 1.0
    ignored, standing = (
        EdgeChecker(world, robots=[0]),
        EdgeChecker(world, robots=[0], moving="at_start"),
    )
    assert ignored.state(first[None])
    assert not standing.state(first[None])
    for checker in (ignored, standing):
        assert not checker.timed_edge(0, first, 0.0, first, 0.1, Traffic.none())
        assert checker.timed_edge(0, first, later, first, later + 1.0, Traffic.none())


@pytest.mark.parametrize(
    ("arrays", "said"),
    [
        (([[0.0, 1.0]], [[[0, 0, 0]]], [0.1]), "give \\[K, P\\]"),
        (([[0.0]], [[[0, 0, 0]]], [0.1, 0.2]), "2 radii for 1 paths"),
        (([[0.0, -1.0]], [[[0, 0, 0], [1, 1, 1]]], [0.1]), "time_s falls"),
        (([[0.0]], [[[0, np.nan, 0]]], [0.1]), "not finite"),
    ],
)
def test_traffic_that_means_nothing_is_refused(arrays, said):
    with pytest.raises(ConfigError, match=said):
        Traffic.of(*arrays)


def test_a_robot_that_is_not_there_is_named(alone):
    with pytest.raises(ConfigError, match="robot = 1: give one of 0 to 0"):
        alone.timed_edge(1, HERE, 0.0, THERE, 1.0, Traffic.none())
