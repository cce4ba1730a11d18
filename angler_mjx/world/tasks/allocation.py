"""Allocation of jobs to robots: nearest first, auction, or a sweep cut into equal parts.

An allocator is a function of one robot's information on a world (`AllocationView`), which may be
the truth; it returns the next job of every robot. With equal information all robots get the same
result; else each robot computes the whole allocation from its own information and takes its own
part.
"""

import importlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import jax
import jax.numpy as jnp

from angler_mjx._moved import renamed as _renamed
from angler_mjx.errors import ConfigError, format_value, report_user_errors
from angler_mjx.world.tasks import pairs
from angler_mjx.world.tasks.travel import Travel


@dataclass(frozen=True, kw_only=True)
class AllocationView:
    """Information on a world for the allocation of jobs."""

    open: jax.Array
    """bool [M] jobs that a robot still has to begin."""
    able: jax.Array
    """bool [R] robots that can take a job."""
    active: jax.Array
    """bool [R] robots that have not ended; robots that carry goods take no other job."""
    p: jax.Array
    """[R, 3] positions of robots, m in W."""
    travel: Travel
    """Paths; the first M places are the beginnings of jobs."""
    length_m: jax.Array
    """[M] path length from the beginning of each job to its end."""
    between_m: Callable[[jax.Array], jax.Array]
    """Path length [M] from the end of a job, int32 [], to the beginnings of all."""
    rank: jax.Array
    """int32 [M] index of each job in boustrophedon order."""
    part: jax.Array
    """int32 [R] each robot's part of that order."""
    exists: jax.Array
    """bool [M] jobs of this world, open or not."""

    @property
    def reach_m(self) -> jax.Array:
        """Return [R, M] path lengths of each robot to the beginning of each job."""
        return self.travel.path_lengths_m(self.p, jnp.arange(self.open.shape[0], dtype=jnp.int32))


type Allocator = Callable[[AllocationView], jax.Array]
"""Next job of each robot, int32 [R]; -1 for none. No job is given to two robots."""


def nearest(view: AllocationView) -> jax.Array:
    """Give each robot the nearest open job, unless another robot is nearer.

    The shortest remaining path is taken repeatedly.
    """
    return pairs.shortest_first(view.travel, view.p, view.able, view.open)


def auction(view: AllocationView) -> jax.Array:
    """Allocate by sequential single-item auction: the lowest bid for any job wins, repeatedly.

    A bid is the robot's path length until the job is done, jobs won before included, so loads are
    balanced (M. G. Lagoudakis et al., "Auction-Based Multi-Robot Routing", Robotics: Science and
    Systems 2005, rule MINIMAX). Each robot goes to the first job that it won; the auction ends when
    every robot has a job.
    """
    robots = jnp.arange(view.able.shape[0])

    def going(state: tuple[jax.Array, jax.Array]) -> jax.Array:
        bids, first = state
        return jnp.any(jnp.isfinite(bids)) & jnp.any((first < 0) & view.able)

    def sell(state: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        bids, first = state
        flat = jnp.argmin(bids)
        robot, job = flat // bids.shape[1], flat % bids.shape[1]
        won = (robots == robot) & jnp.isfinite(bids[robot, job])
        first = jnp.where(won & (first < 0), job, first).astype(jnp.int32)
        sold = jnp.isinf(bids).all(axis=0).at[job].set(True)
        after = bids[robot, job] + view.between_m(job) + view.length_m
        bids = jnp.where(won[:, None], after, bids)
        return jnp.where(sold, jnp.inf, bids), first

    bids = jnp.where(view.open & view.able[:, None], view.reach_m + view.length_m, jnp.inf)
    none = jnp.full(view.able.shape, -1, jnp.int32)
    return jax.lax.while_loop(going, sell, (bids, none))[1]


def sweep(view: AllocationView) -> jax.Array:
    """Allocate jobs in boustrophedon order, cut into contiguous parts of equal size within one.

    Each robot does its part in order. Parts of lost robots are cut again among the robots without
    remaining jobs.
    """
    robots = view.able.shape[0]
    count = jnp.sum(view.exists, dtype=jnp.int32)
    part = part_of(view.rank, count, robots)
    robot_jobs = view.open & view.exists & (part == view.part[:, None])
    first_job = _first_job(robot_jobs, view.rank)
    idle = view.able & (first_job < 0)
    orphan = view.open & ~jnp.any(robot_jobs & view.active[:, None], axis=0)
    # Indices of the orphaned jobs among themselves, cut among the idle robots.
    earlier = (view.rank[:, None] > view.rank) & orphan
    orphan_rank = jnp.sum(earlier, axis=1, dtype=jnp.int32)
    among = jnp.maximum(jnp.sum(idle, dtype=jnp.int32), 1)
    left = jnp.sum(orphan, dtype=jnp.int32)
    number = jnp.cumsum(idle, dtype=jnp.int32) - 1
    theirs = orphan & (part_of(orphan_rank, left, among) == number[:, None])
    return jnp.where(idle, _first_job(theirs, view.rank), jnp.where(view.able, first_job, -1))


def part_of(rank: jax.Array, count: jax.Array, parts: jax.Array | int) -> jax.Array:
    """Return the contiguous part, equal in size within one, of each index in an order."""
    return rank * parts // jnp.maximum(count, 1)


def _first_job(may: jax.Array, rank: jax.Array) -> jax.Array:
    """Return the first allowed job in order, bool [..., M]; -1 where none is."""
    best = jnp.argmin(jnp.where(may, rank, rank.shape[-1]), axis=-1)
    return jnp.where(jnp.any(may, axis=-1), best, -1).astype(jnp.int32)


def in_order(view: AllocationView) -> jax.Array:
    """Give each robot the open job of the lowest number; for tours in order."""
    jobs = jnp.arange(view.open.shape[0], dtype=jnp.int32)
    return jnp.where(view.able, _first_job(view.open, jobs), -1)


BUILT_IN: Mapping[str, Allocator] = {"nearest": nearest, "auction": auction, "sweep": sweep}
"""Allocators by their names in scenario files."""


def find_allocator(name: str) -> Allocator:
    """Return an allocator.

    Args:
        name: one of `BUILT_IN`, or MODULE:FUNCTION of an installed package.

    Raises:
        ConfigError: there is no allocator of that name.
    """
    if name in BUILT_IN:
        return BUILT_IN[name]
    module, colon, function = name.partition(":")
    names = ", ".join(BUILT_IN)
    if not colon:
        raise ConfigError(
            f"{format_value(name)} shares out no jobs; there are {names}, MODULE:FUNCTION"
        )
    try:
        with report_user_errors(f"{format_value(name)}: the module"):
            candidate = getattr(importlib.import_module(module), function)
    except ConfigError as error:
        raise ConfigError(f"{error}; there are {names}, MODULE:FUNCTION") from error
    if not callable(candidate):
        raise ConfigError(f"{format_value(name)} is no function")
    allocator: Allocator = candidate
    return allocator


def named_in_errors(name: str) -> Allocator:
    """Return an allocator as `find_allocator` does; its exceptions name their file and line."""
    allocator = find_allocator(name)

    def allocate(view: AllocationView) -> jax.Array:
        with report_user_errors(f"task.allocation = {format_value(name)}: the function"):
            return allocator(view)

    return allocate


def __getattr__(name: str) -> object:
    """Return what had another name before 0.2."""
    return _renamed(__name__, name)
