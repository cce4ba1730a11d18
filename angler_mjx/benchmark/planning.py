"""Asking planners the problems of a setting: answers into the database as they come."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import numpy as np

from angler_mjx.benchmark import paths as bytes_of
from angler_mjx.benchmark.columns import WORDS
from angler_mjx.benchmark.measures import of_answer
from angler_mjx.benchmark.questions import Contestant, Setting
from angler_mjx.benchmark.store import Store
from angler_mjx.control import plans
from angler_mjx.errors import AnglerError
from angler_mjx.planning.answers import Answer, answer, failed
from angler_mjx.planning.host.pool import Pool
from angler_mjx.planning.planner import NoPlan, Path
from angler_mjx.planning.problem import Problem
from angler_mjx.sim.state import World
from angler_mjx.simulator.prepare import device_planner
from angler_mjx.simulator.simulator import Simulator

NO_ROOM = "the world cannot hold the team"
"""Why nobody is asked a problem."""


@dataclass(frozen=True, kw_only=True)
class Asked:
    """The problems of a setting."""

    setting: Setting
    experiment: int
    """Its number in the database."""
    problems: Sequence[Problem]
    """In arrays of NumPy."""
    fits: np.ndarray
    """bool [n] whether each world can hold the team."""
    difficulty: Sequence[Mapping[str, float]]
    """Columns of each world."""
    worlds: World
    """Of the problems, as they were drawn."""
    batch: Problem
    """The problems in one batch, where the worlds are."""


def ask(setting: Setting, simulator: Simulator, experiment: int) -> Asked:
    """Draw the problems of a setting."""
    count = setting.scenario.worlds
    worlds, batch = simulator.asked(0, seed=setting.seed, knows=setting.knows)
    environment = jax.tree.map(np.asarray, worlds.environment)
    apart = np.linalg.norm(environment.goal_m - environment.start_m, axis=-1)
    difficulty = [
        {
            "density": float(environment.density[i]),
            "path_ratio": float(environment.path_ratio[i].mean()),
            "free_lines": float(environment.line_free[i].mean()),
            "straight_m": float(apart[i].sum()),
        }
        for i in range(count)
    ]
    return Asked(
        setting=setting,
        experiment=experiment,
        problems=simulator.named(batch, 0, count, seed=setting.seed),
        fits=environment.valid[:count],
        difficulty=difficulty,
        worlds=worlds,
        batch=batch,
    )


def plan(
    asked: Asked,
    contestants: Sequence[tuple[int, Contestant]],
    store: Store,
    pool: Callable[[], Pool],
    close_after: int,
    advance: Callable[[int], None],
) -> None:
    """Have planners plan the problems that they have not answered yet.

    Args:
        asked: the problems.
        contestants: with their numbers in the database.
        store: where answers are kept.
        pool: that plans, where a planner is one of the host.
        close_after: a planner without any plan for so many first problems is not asked the others;
            0: never.
        advance: called with the number of problems that are done or given up.
    """
    todo = {number: _left(asked, number, store, advance) for number, _ in contestants}
    first = close_after or len(asked.problems)
    for part in (slice(0, first), slice(first, None)):
        chosen = set(range(len(asked.problems))[part])
        orders = []
        for number, one in contestants:
            worlds = [world for world in todo[number] if world in chosen]
            if worlds and part.start and _hopeless(asked, number, store, first):
                reason = f"no plan for any of its first {first} problems here"
                store.close_cell(asked.experiment, number, worlds, reason)
                advance(len(worlds))
            elif worlds:
                orders.append((number, one, worlds))
        for number, world, given in _answers(asked, orders, pool):
            _keep(asked, number, world, given, store)
            advance(1)


def _left(asked: Asked, planner: int, store: Store, advance: Callable[[int], None]) -> list[int]:
    """Problems that a planner is still to be asked."""
    where = (asked.experiment, planner)
    done = {
        row["world"]
        for table in ("runs", "closed")
        for row in store.rows(
            f"SELECT world FROM {table} WHERE experimentid = ? AND plannerid = ?", where
        )
    }
    worlds = [world for world in range(len(asked.problems)) if world not in done]
    barred = [world for world in worlds if not asked.fits[world]]
    store.close_cell(asked.experiment, planner, barred, NO_ROOM)
    advance(len(done) + len(barred))
    return [world for world in worlds if asked.fits[world]]


def _hopeless(asked: Asked, planner: int, store: Store, first: int) -> bool:
    rows = store.rows(
        "SELECT count(*) AS runs, coalesce(sum(robots_planned), 0) AS paths FROM runs "
        "WHERE experimentid = ? AND plannerid = ? AND world < ?",
        (asked.experiment, planner, first),
    )
    return bool(rows[0]["runs"] and not rows[0]["paths"])


def _answers(
    asked: Asked,
    orders: Sequence[tuple[int, Contestant, Sequence[int]]],
    pool: Callable[[], Pool],
) -> Iterator[tuple[int, int, Answer]]:
    """Planner, world and answer, as they come."""
    tickets: dict[int, tuple[int, int]] = {}
    for number, one, worlds in orders:
        if one.on_device:
            for world, given in _of_device(asked, one, worlds):
                yield number, world, given
            continue
        for world in worlds:
            ticket = pool().submit(asked.problems[world], one.spec_of(asked.setting))
            tickets[ticket] = number, world
    if tickets:
        for ticket, given in pool().completed(tickets):
            yield *tickets[ticket], given


def _of_device(
    asked: Asked, one: Contestant, worlds: Sequence[int]
) -> Iterator[tuple[int, Answer]]:
    """Answers of a planner that plans a batch: each took its share of the batch's time."""
    setting = asked.setting
    about = setting.scenario.planner.model_copy(update={"knows": setting.known()})
    try:
        planner = jax.jit(
            device_planner(setting.scenario.model_copy(update={"planner": about}), one.spec)
        )
        begin = time.perf_counter()
        compiled = planner.lower(asked.worlds, asked.batch).compile()
        warm_up_s = time.perf_counter() - begin
        jax.block_until_ready(compiled(asked.worlds, asked.batch))
        begin = time.perf_counter()
        path = jax.block_until_ready(compiled(asked.worlds, asked.batch))
    except (AnglerError, jax.errors.JaxRuntimeError, TypeError, ValueError) as error:
        robots = setting.robots
        text = f"{type(error).__name__}: {error}"
        yield from ((world, failed(robots, "error", text, 0.0)) for world in worlds)
        return
    count = len(asked.problems)
    seconds = (time.perf_counter() - begin) / count
    host = jax.tree.map(np.asarray, path)
    for i, world in enumerate(worlds):
        extras = {"warm_up_s": warm_up_s} if i == 0 else {}
        own = [_robot(host, world, robot) for robot in range(setting.robots)]
        yield world, answer(own, asked.problems[world], seconds, extras)


def _robot(host: Any, world: int, robot: int) -> Path | NoPlan:
    """The path of one robot out of a batch, without the rows that repeat its last."""
    one: Any = jax.tree.map(lambda leaf: leaf[world, robot], host)
    if not bool(plans.found(one)):
        return NoPlan("no way found")
    end = int(np.argmax(one.time_s >= one.time_s[-1])) + 1
    cut = {
        name: getattr(one, name)[: max(end, 2)]
        for name in ("time_s", "position_m", "position", "velocity", "acceleration", "degree")
        if hasattr(one, name) and np.ndim(getattr(one, name)) > 0
    }
    kept: Path = replace(one, **cut)
    return kept


def _keep(asked: Asked, planner: int, world: int, given: Answer, store: Store) -> None:
    there = any(not isinstance(path, NoPlan) for path in given.paths)
    row = {
        **dict.fromkeys(WORDS),
        **of_answer(given),
        **asked.difficulty[world],
        "plan_reason": given.reason or None,
        "success": False,
        "reached": False,
        "robots_reached": 0,
        **({} if there else {"flown": False}),
    }
    store.add(
        asked.experiment,
        planner,
        world,
        given.status,
        row,
        bytes_of.packed(given.paths) if there else None,
        given.progress,
    )
