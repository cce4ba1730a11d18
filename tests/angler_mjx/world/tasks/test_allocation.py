"""Allocators against plain Python, and what every sharing-out must be."""

import itertools
import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.world.tasks import allocation
from angler_mjx.world.tasks.allocation import AllocationView
from angler_mjx.world.tasks.travel import Travel

ROBOTS, JOBS = 4, 11


def view(
    robots_m: Any,
    jobs_m: Any,
    open_: Any,
    able: Any,
    active: Any = None,
    rank: Any = None,
) -> AllocationView:
    robots, jobs = robots_m.shape[0], jobs_m.shape[0]
    return AllocationView(
        open=jnp.asarray(open_),
        able=jnp.asarray(able),
        active=jnp.asarray(able if active is None else active),
        p=robots_m,
        travel=Travel(position_m=jobs_m),
        length_m=jnp.zeros(jobs),
        between_m=lambda job: jnp.sqrt(jnp.sum((jobs_m - jobs_m[job]) ** 2, axis=-1)),
        rank=jnp.arange(jobs) if rank is None else jnp.asarray(rank),
        part=jnp.arange(robots, dtype=jnp.int32),
        exists=jnp.ones(jobs, bool),
    )


def compiled(name: str) -> Callable[..., Any]:
    return jax.jit(lambda *scene: allocation.find_allocator(name)(view(*map(jnp.asarray, scene))))


GIVEN = {name: compiled(name) for name in allocation.BUILT_IN}


def scenes() -> list[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    random = np.random.default_rng(5)
    return [
        (
            random.uniform(-10, 10, (ROBOTS, 3)),
            random.uniform(-10, 10, (JOBS, 3)),
            random.random(JOBS) < share,
            random.random(ROBOTS) < 0.8,
        )
        for share in (0.0, 0.2, 0.6, 1.0, 1.0, 1.0)
    ]


def shortest_first(
    robots: np.ndarray, jobs: np.ndarray, open_: np.ndarray, able: np.ndarray
) -> list[int]:
    """The shortest way of all, again and again."""
    taken = [-1] * len(robots)
    while True:
        pairs = [
            (math.dist(robots[r], jobs[m]), r, m)
            for r, m in itertools.product(range(len(robots)), range(len(jobs)))
            if able[r] and open_[m] and taken[r] < 0 and m not in taken
        ]
        if not pairs:
            return taken
        _, r, m = min(pairs)
        taken[r] = m


def whole_auction(
    robots: np.ndarray, jobs: np.ndarray, open_: np.ndarray, able: np.ndarray
) -> list[list[int]]:
    """What each robot wins when all jobs are sold, one at a time, to the least load."""
    won: list[list[int]] = [[] for _ in robots]
    load, at = [0.0] * len(robots), [tuple(p) for p in robots]
    left = set(np.flatnonzero(open_).tolist())
    while left and any(able):
        bid, r, m = min(
            (load[r] + math.dist(at[r], jobs[m]), r, m)
            for r in range(len(robots))
            if able[r]
            for m in left
        )
        won[r].append(m)
        load[r], at[r] = bid, tuple(jobs[m])
        left.remove(m)
    return won


@pytest.mark.parametrize("scene", scenes())
def test_nearest_gives_the_shortest_ways_first(scene: tuple[np.ndarray, ...]) -> None:
    given = GIVEN["nearest"](*scene)
    assert given.tolist() == shortest_first(*scene)


@pytest.mark.parametrize("scene", scenes())
def test_each_goes_to_the_first_job_that_it_wins_in_a_whole_auction(
    scene: tuple[np.ndarray, ...],
) -> None:
    won = whole_auction(*scene)
    given = GIVEN["auction"](*scene).tolist()
    # Once every robot has a job the auction ends: what is sold later changes nothing for now.
    assert given == [jobs[0] if jobs else -1 for jobs in won]


def test_shares_of_a_sweep_are_contiguous_and_equal_within_one() -> None:
    for robots, count in itertools.product((1, 3, 4, 7), (1, 5, 12, 13)):
        part = np.asarray(allocation.part_of(jnp.arange(count), jnp.int32(count), robots))
        sizes = np.bincount(part, minlength=robots)
        assert np.all(np.diff(part) >= 0)
        assert sizes.max() - sizes.min() <= 1
        assert sizes.sum() == count


def test_a_sweep_does_every_job_once_even_of_robots_that_are_lost() -> None:
    random = np.random.default_rng(8)
    robots, jobs = random.uniform(-9, 9, (ROBOTS, 3)), random.uniform(-9, 9, (JOBS, 3))
    rank = random.permutation(JOBS)
    open_, able = np.ones(JOBS, bool), np.ones(ROBOTS, bool)
    done: list[int] = []
    while open_.any():
        given = np.asarray(GIVEN["sweep"](robots, jobs, open_, able, able, rank))
        chosen = given[given >= 0]
        assert len(set(chosen.tolist())) == len(chosen) > 0
        assert open_[chosen].all()
        assert (given[~able] == -1).all()
        done += chosen.tolist()
        open_[chosen] = False
        able[1] = len(done) < 3  # is lost with jobs of its own left
    assert sorted(done) == list(range(JOBS))


def test_a_sweep_leaves_the_jobs_of_robots_that_carry_to_them() -> None:
    robots, jobs = np.zeros((2, 3)), np.arange(12.0).reshape(4, 3)
    open_ = np.array([False, True, False, False])  # 0 is carried, 2 and 3 are done
    able, active = np.array([False, True]), np.ones(2, bool)
    given = allocation.sweep(view(robots, jobs, open_, able, active))
    assert given.tolist() == [-1, -1]


def test_no_allocator_gives_a_job_to_two_or_one_that_is_not_open() -> None:
    for name in allocation.BUILT_IN:
        for scene in scenes():
            given = np.asarray(GIVEN[name](*scene))
            chosen = given[given >= 0]
            assert len(set(chosen.tolist())) == len(chosen)
            assert scene[2][chosen].all()
            assert scene[3][given >= 0].all()


def test_allocators_of_others_are_found_by_module_and_function() -> None:
    assert (
        allocation.find_allocator("angler_mjx.world.tasks.allocation:in_order")
        is allocation.in_order
    )
    for name in ("farthest", "no_such_module:f", "angler_mjx.world.tasks.allocation:none"):
        with pytest.raises(ConfigError, match="nearest, auction, sweep"):
            allocation.find_allocator(name)
