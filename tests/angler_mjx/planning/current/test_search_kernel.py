"""Least costs as a GPU program, against Dijkstra's algorithm and the batch's own sweeps."""

import heapq
import itertools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.planning.current import search, search_kernel

SHAPE = (9, 7, 5)


def costs_of_a_maze(seed: int) -> np.ndarray:
    """float16 [26, *SHAPE]: random costs, a third of the steps not free, none that leave."""
    rng = np.random.default_rng(seed)
    cost = rng.uniform(0.5, 4.0, (26, *SHAPE))
    cost[rng.random(cost.shape) < 0.6] = np.inf
    cells = np.stack(np.meshgrid(*(np.arange(n) for n in SHAPE), indexing="ij"), axis=-1)
    for number, step in enumerate(search.STEPS):
        beside = cells + step
        cost[number][np.any((beside < 0) | (beside >= SHAPE), axis=-1)] = np.inf
    return cost.astype(np.float16)


def by_dijkstra(cost: np.ndarray, goal: tuple[int, ...]) -> np.ndarray:
    """Least costs [*SHAPE] to a goal; infinite where there is no way."""
    least = np.full(SHAPE, np.inf)
    least[goal] = 0.0
    queue = [(0.0, goal)]
    while queue:
        far, cell = heapq.heappop(queue)
        if far > least[cell]:
            continue
        for number, step in enumerate(search.STEPS):
            before = tuple(int(c) for c in np.array(cell) - step)
            if all(0 <= c < n for c, n in zip(before, SHAPE, strict=True)):
                total = far + float(cost[number][before])
                if total < least[before]:
                    least[before] = total
                    heapq.heappush(queue, (total, before))
    return least


@pytest.mark.parametrize("lanes", [64, 1024])
def test_costs_are_those_of_dijkstra_and_of_the_sweeps_of_a_batch_to_the_last_bit(
    lanes: int, monkeypatch: pytest.MonkeyPatch, block_form: Callable[..., Any]
) -> None:
    monkeypatch.setattr(search_kernel, "_MAX_LANES", lanes)
    cost = np.stack([costs_of_a_maze(seed) for seed in (1, 2, 3)])
    goals = [(0, 0, 0), (4, 3, 2), (8, 6, 4)]
    at_once = jax.vmap(block_form(search_kernel.costs_to_goal))
    value = np.asarray(at_once(jnp.array(cost), jnp.array(goals, jnp.int32)))
    swept = search.costs_to_goal(jnp.array(cost), jnp.array(goals, jnp.int32))
    assert np.array_equal(value, np.asarray(swept))
    for one, of, goal in zip(value, cost, goals, strict=True):
        known = by_dijkstra(of, goal)
        assert np.array_equal(one >= search.NO_PATH_COST, np.isinf(known))
        assert np.allclose(
            one[one < search.NO_PATH_COST], known[one < search.NO_PATH_COST], rtol=1e-5
        )


def test_ways_cost_what_the_search_says_from_every_cell() -> None:
    cost, goal = costs_of_a_maze(4), (0, 6, 2)
    value = search.costs_to_goal(jnp.array(cost[None]), jnp.array([goal], jnp.int32))[0]
    starts = np.array(list(np.ndindex(SHAPE)), np.int32)
    follow = jax.vmap(lambda start: search.trace_path(jnp.array(cost), value, start, 40))
    cells, reached = map(np.asarray, follow(jnp.array(starts)))
    known = by_dijkstra(cost, goal)
    assert np.array_equal(reached, np.isfinite(known[tuple(starts.T)]))
    assert reached.sum() > 200
    numbers = {tuple(step): number for number, step in enumerate(search.STEPS.tolist())}
    for way, start in zip(cells[reached], starts[reached], strict=True):
        steps = itertools.pairwise(way)
        total = sum(float(cost[numbers[tuple(b - a)]][tuple(a)]) for a, b in steps if any(b - a))
        assert total == pytest.approx(known[tuple(start)], rel=1e-5)


def test_cells_without_a_way_are_far() -> None:
    cost = np.full((26, *SHAPE), np.inf, np.float16)
    value = search_kernel.costs_to_goal(
        jnp.array(cost), jnp.array((1, 1, 1), jnp.int32), interpret=True
    )
    assert float(value[1, 1, 1]) == 0.0
    assert np.sum(np.asarray(value) >= search.NO_PATH_COST) == value.size - 1


def test_it_lowers_for_a_gpu(lower_for_gpu: Callable[..., None]) -> None:
    cost = jax.ShapeDtypeStruct((8, 26, 16, 16, 16), jnp.float16)
    goal = jax.ShapeDtypeStruct((8, 3), jnp.int32)
    lower_for_gpu(jax.vmap(search_kernel.costs_to_goal), cost, goal)
