"""Asking planners the problems of a setting: answers into the database as they come."""

import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import numpy as np

from angler_mjx.planning.answers import Answer, answer, failed
from angler_mjx.planning.host.pool import Pool
from angler_mjx.planning.host.processes.runner import LATE
from angler_mjx.planning.planner import NoPlan, Path, PathShape
from angler_mjx.planning.problem import Problem
from angler_mjx.robot.control import plans
from angler_mjx.robot.control.joint_trajectory import JointTrajectory
from angler_mjx.robot.control.trajectory import Trajectory
from angler_mjx.runs.simulator.compiling import Compiled
from angler_mjx.runs.simulator.on_device import device_planner
from angler_mjx.runs.simulator.prepare import with_paths
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.studies.benchmark import paths as bytes_of
from angler_mjx.studies.benchmark.columns import CLOSED, NO_ROOM, POLICY, WORDS
from angler_mjx.studies.benchmark.compared_planners import ComparedPlanner
from angler_mjx.studies.benchmark.measures import of_answer
from angler_mjx.studies.benchmark.questions import Setting
from angler_mjx.studies.benchmark.store import BenchmarkStore
from angler_mjx.world.environment import Environment


@dataclass(frozen=True, kw_only=True)
class SettingProblems:
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
    simulator: Simulator
    """That draws their worlds, a tile at a time."""


def ask(setting: Setting, simulator: Simulator, experiment: int) -> SettingProblems:
    """Draw the problems of a setting."""
    problems: list[Problem] = []
    difficulty: list[Mapping[str, float]] = []
    fits: list[bool] = []
    for first in _tiles(setting, simulator):
        count = min(simulator.tile, setting.scenario.worlds - first)
        worlds, batch = simulator.asked(first, seed=setting.seed, knows=setting.knows)
        problems += simulator.named(batch, first, count, seed=setting.seed)
        environment = jax.tree.map(np.asarray, worlds.environment)
        difficulty += [_difficulty(environment, i) for i in range(count)]
        fits += environment.valid[:count].tolist()
    return SettingProblems(
        setting=setting,
        experiment=experiment,
        problems=problems,
        fits=np.array(fits),
        difficulty=difficulty,
        simulator=simulator,
    )


def _tiles(setting: Setting, simulator: Simulator) -> range:
    return range(0, setting.scenario.worlds, simulator.tile)


def _difficulty(environment: Environment, world: int) -> dict[str, float]:
    apart = np.asarray(environment.goal_m - environment.start_m)[world]
    return {
        "density": float(environment.density[world]),
        "path_ratio": float(environment.path_ratio[world].mean()),
        "free_lines": float(environment.line_free[world].mean()),
        "straight_m": float(np.linalg.norm(apart, axis=-1).sum()),
    }


def plan(
    asked: SettingProblems,
    contestants: Sequence[tuple[int, ComparedPlanner]],
    store: BenchmarkStore,
    pool: Pool,
    close_after: int,
    advance: Callable[[int], None],
) -> None:
    """Have planners plan the problems that they have not answered yet.

    Args:
        asked: the problems.
        contestants: with their numbers in the database.
        store: where answers are kept.
        pool: where planners of the host plan.
        close_after: a planner without any plan for so many first problems is not asked the others;
            0: never.
        advance: called with the number of problems that are done or given up.
    """
    todo = {number: _left(asked, number, store, advance) for number, _ in contestants}
    for number, one in contestants:
        if one.policy is not None:
            for world in sorted(todo.pop(number)):
                _keep_unplanned(asked, number, world, store)
                advance(1)
    contestants = [(number, one) for number, one in contestants if number in todo]
    fitting = np.flatnonzero(asked.fits).tolist()
    first = fitting[:close_after] if close_after else fitting
    for part in (first, fitting[len(first) :]):
        orders = []
        for number, one in contestants:
            worlds = [world for world in part if world in todo[number]]
            if worlds and part is not first and _hopeless(asked, number, store, first[-1]):
                reason = f"no plan for any of its first {len(first)} problems here"
                store.leave(asked.experiment, number, worlds, CLOSED, reason)
                advance(len(worlds))
            elif worlds:
                orders.append((number, one, worlds))
        for number, one, world, given in _answers(asked, orders, pool):
            _keep(asked, number, world, _of_kind(given, one), store)
            advance(1)


def _left(
    asked: SettingProblems, planner: int, store: BenchmarkStore, advance: Callable[[int], None]
) -> set[int]:
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
    store.leave(asked.experiment, planner, barred, NO_ROOM, "the world cannot hold the team")
    advance(len(done) + len(barred))
    return {world for world in worlds if asked.fits[world]}


def _hopeless(asked: SettingProblems, planner: int, store: BenchmarkStore, last: int) -> bool:
    """Whether a planner has no plan for any problem up to the last of the first."""
    rows = store.rows(
        "SELECT count(*) AS runs, coalesce(sum(robots_planned), 0) AS paths FROM runs "
        "WHERE experimentid = ? AND plannerid = ? AND world <= ?",
        (asked.experiment, planner, last),
    )
    return bool(rows[0]["runs"] and not rows[0]["paths"])


def _answers(
    asked: SettingProblems,
    orders: Sequence[tuple[int, ComparedPlanner, Sequence[int]]],
    pool: Pool,
) -> Iterator[tuple[int, ComparedPlanner, int, Answer]]:
    """Planner, world and answer, as they come; nobody is asked while a device plans."""
    compiled: dict[str, Any] = {}
    for number, one, worlds in orders:
        if one.on_device:
            for world, given in _of_device(asked, one, worlds, compiled):
                yield number, one, world, given
    tickets: dict[int, tuple[int, ComparedPlanner, int]] = {}
    for number, one, worlds in orders:
        for world in worlds if not one.on_device else ():
            ticket = pool.submit(asked.problems[world], one.spec_of(asked.setting.scenario))
            tickets[ticket] = number, one, world
    for ticket, given in pool.completed(tickets):
        yield *tickets[ticket], given


def _of_kind(given: Answer, one: ComparedPlanner) -> Answer:
    """An answer whose paths are all of the kind that the planner says it gives."""
    wrong = [
        path
        for path in given.paths
        if not isinstance(path, NoPlan | JointTrajectory if one.joints else NoPlan | Trajectory)
    ]
    if not wrong:
        return given
    reason = f"gives {type(wrong[0]).__name__}, and its class says joints = {one.joints}"
    paths = [NoPlan(reason) if any(path is x for x in wrong) else path for path in given.paths]
    none = all(isinstance(path, NoPlan) for path in paths)
    return replace(given, paths=paths, status="none" if none else "partial", reason=reason)


def _of_device(
    asked: SettingProblems, one: ComparedPlanner, worlds: Sequence[int], programs: dict[str, Any]
) -> Iterator[tuple[int, Answer]]:
    """Answers of a planner that plans a batch: each took its share of the batch's time.

    Programs are shared by those that plan alike, and fly otherwise.
    """
    setting, simulator = asked.setting, asked.simulator
    shape = PathShape(points=setting.scenario.planner.points, joints=one.joints)
    limit_s = LATE * setting.scenario.planner.deadline_s
    extras = {}
    alike = json.dumps([one.name, one.settings], sort_keys=True)
    for first in _tiles(setting, simulator):
        wanted = [world for world in worlds if first <= world < first + simulator.tile]
        if not wanted:
            continue
        given = simulator.asked(first, seed=setting.seed, knows=setting.knows)
        try:
            if alike not in programs:
                begin = time.perf_counter()
                planner = device_planner(setting.told(), one.planner)
                program = Compiled(planner)
                programs[alike] = program.lower(*given).compile()
                jax.block_until_ready(programs[alike](*given))
                extras = {"warm_up_s": time.perf_counter() - begin}
            begin = time.perf_counter()
            path = jax.block_until_ready(programs[alike](*given))
            seconds = time.perf_counter() - begin
            with_paths(given[0], path, one.label, shape)
            host = jax.device_get(path)
            teams = {w: [_robot(host, w - first, r) for r in range(setting.robots)] for w in wanted}
        except Exception as error:  # anybody's code: it is this planner's failure, and no more
            text = f"{type(error).__name__}: {' '.join(str(error).split())[:300]}"
            yield from ((w, failed(setting.robots, "error", text, 0.0)) for w in wanted)
            continue
        share_s = seconds / min(simulator.tile, setting.scenario.worlds)
        for world, own in teams.items():
            if share_s > limit_s:
                text = f"took {share_s:.3g} s a problem; it had {limit_s / LATE:g} s"
                yield world, failed(setting.robots, "timeout", text, share_s)
            else:
                yield (
                    world,
                    answer(
                        own,
                        asked.problems[world],
                        share_s,
                        extras,
                        shape.points,
                        any_speed=True,
                    ),
                )
            extras = {}


def _robot(host: Any, world: int, robot: int) -> Path | NoPlan:
    """The path of one robot out of a batch, without the rows that repeat its last."""
    one: Any = jax.tree.map(lambda leaf: leaf[world, robot], host)
    if not bool(plans.found(one)):
        return NoPlan("no way found")
    differing = np.flatnonzero(one.time_s != one.time_s[-1])
    end = int(differing[-1]) + 2 if len(differing) else 2
    cut = {
        name: getattr(one, name)[:end]
        for name in ("time_s", "position_m", "position", "velocity", "acceleration", "degree")
        if hasattr(one, name) and np.ndim(getattr(one, name)) > 0
    }
    kept: Path = replace(one, **cut)
    return kept


def _keep(
    asked: SettingProblems, planner: int, world: int, given: Answer, store: BenchmarkStore
) -> None:
    there = any(not isinstance(path, NoPlan) for path in given.paths)
    row = {
        **_nothing_flown(asked, world),
        **of_answer(given),
        "plan_reason": given.reason or None,
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


def _keep_unplanned(
    asked: SettingProblems, planner: int, world: int, store: BenchmarkStore
) -> None:
    """A run of a policy, to be flown."""
    row = {**_nothing_flown(asked, world), "planned": False, "robots_planned": 0}
    store.add(asked.experiment, planner, world, POLICY, row, None)


def _nothing_flown(asked: SettingProblems, world: int) -> dict[str, Any]:
    return {
        **dict.fromkeys(WORDS),
        **asked.difficulty[world],
        "success": False,
        "reached": False,
        "robots_reached": 0,
    }
