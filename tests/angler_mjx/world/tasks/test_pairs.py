"""Robots and jobs by the shortest of drawn ways, against plain Python."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from angler_kernels.matching import MatchedPairs
from angler_mjx.world.routes import NO_PATH, Routes
from angler_mjx.world.tasks import pairs
from angler_mjx.world.tasks.travel import Travel

ROBOTS, JOBS, SHAPE, CELL_M = 3, 9, (4, 5, 3), 1.5
PLACES = JOBS + 2
ORIGIN_M = np.array([-3.0, -4.0, -1.0])


def scene(seed: int) -> dict[str, Any]:
    """Steps and lengths that fit together nowhere, which nobody asks for."""
    random = np.random.default_rng(seed)
    words = random.integers(0, 27, (*SHAPE, PLACES)) | random.integers(0, 90, PLACES) << 5
    words[random.random(words.shape) < 0.2] = NO_PATH
    size = np.array(SHAPE) * CELL_M
    return {
        "words": words.astype(np.uint16),
        "place_m": ORIGIN_M + random.uniform(0.0, 1.0, (PLACES, 3)) * size,
        "p": ORIGIN_M + random.uniform(-0.2, 1.2, (ROBOTS, 3)) * size,  # some are off the grid
        "able": random.random(ROBOTS) < (0.0 if seed == 0 else 0.8),
        "open_": random.random(JOBS) < random.choice([0.1, 0.7]),
    }


def by_hand(words: Any, place_m: Any, p: Any, able: Any, open_: Any) -> list[int]:
    def way(robot: int, job: int) -> float:
        last = np.array(SHAPE) - 1
        cell = np.clip(np.floor((p[robot] - ORIGIN_M) / CELL_M).astype(int), 0, last)
        word = int(words[*cell, job])
        if word == NO_PATH:
            return 4.0 * float(np.linalg.norm(place_m[job] - p[robot]))
        step = np.array(np.unravel_index(word % 32, (3, 3, 3))) - 1
        rest = (word // 32) * CELL_M / 8 - CELL_M * np.sqrt(np.abs(step).sum())
        if rest < CELL_M / 2:
            return float(np.linalg.norm(place_m[job] - p[robot]))
        centre = ORIGIN_M + (cell + step + 0.5) * CELL_M
        return float(np.linalg.norm(centre - p[robot])) + rest

    left = {(r, j): way(r, j) for r in range(ROBOTS) for j in range(JOBS) if able[r] and open_[j]}
    taken = [-1] * ROBOTS
    while left:
        robot, job = min(left, key=lambda pair: left[pair])
        taken[robot] = job
        left = {(r, j): w for (r, j), w in left.items() if r != robot and j != job}
    return taken


def routes(words: Any, place_m: Any) -> Routes:
    return Routes(
        words=words,
        position_m=place_m,
        clear=jnp.zeros((0, 0, 0), jnp.uint32),
        origin_m=jnp.array(ORIGIN_M),
        cell_m=jnp.array(CELL_M),
    )


def plain(words: Any, place_m: Any, p: Any, able: Any, open_: Any) -> Any:
    travel = Travel(position_m=place_m, routes=routes(words, place_m))
    return pairs.shortest_first(travel, p, able, open_)


def kernel(words: Any, place_m: Any, p: Any, able: Any, open_: Any, interpret: bool) -> Any:
    asking = MatchedPairs.of((ROBOTS, JOBS), lanes_per_warp=64, interpret=interpret)
    return pairs._MatchingKernel(asking, words.shape).run(routes(words, place_m), p, able, open_)


def test_the_shortest_way_of_those_left_is_taken() -> None:
    check(plain)


def test_the_program_for_gpus_takes_the_same(block_form: Callable[..., Any]) -> None:
    check(block_form(kernel))


def check(found: Callable[..., Any]) -> None:
    scenes = [scene(seed) for seed in range(40)]
    together = {name: jnp.array(np.stack([one[name] for one in scenes])) for name in scenes[0]}
    each = jax.jit(jax.vmap(lambda given: found(**given)))(together)
    assert each.tolist() == [by_hand(**one) for one in scenes]
    assert np.any(np.asarray(each) >= 0)
