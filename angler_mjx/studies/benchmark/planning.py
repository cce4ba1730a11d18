"""Asking planners the problems of a setting: answers into the database as they come."""

import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import jax
import numpy as np
from jax.stages import Compiled

from angler_mjx.planning.answers import Answer, check_answer, failed_answer
from angler_mjx.planning.device_planner import build_device_planner
from angler_mjx.planning.host.pool import Pool
from angler_mjx.planning.host.workers import DEADLINE_FACTOR
from angler_mjx.planning.planner import NoPlan, Path, PathShape
from angler_mjx.planning.problem import Problem
from angler_mjx.robot.control import plans
from angler_mjx.robot.control.commands.joint_trajectory import JointTrajectory
from angler_mjx.robot.control.commands.trajectory import Trajectory
from angler_mjx.robot.control.plans import Plan
from angler_mjx.runs.simulator.compilation import CompiledFunction
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.runs.simulator.world_preparation import problem_settings, replace_paths
from angler_mjx.studies.benchmark import path_archive as bytes_of
from angler_mjx.studies.benchmark.columns import CLOSED, NO_ROOM, POLICY, TEXT_COLUMNS
from angler_mjx.studies.benchmark.compared_planners import ComparedPlanner
from angler_mjx.studies.benchmark.measures import measure_answer
from angler_mjx.studies.benchmark.problem_settings import Setting
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


def sample_problems(setting: Setting, simulator: Simulator, experiment: int) -> SettingProblems:
    """Draw the problems of a setting."""
    problems: list[Problem] = []
    difficulty: list[Mapping[str, float]] = []
    fits: list[bool] = []
    for first in _tile_starts(setting, simulator):
        count = min(simulator.tile, setting.scenario.worlds - first)
        worlds, batch = simulator.sample_problems(
            first, seed=setting.seed, information=setting.information
        )
        problems += simulator.named(batch, first, count, seed=setting.seed)
        environment = jax.tree.map(np.asarray, worlds.environment)
        difficulty += [_measure_difficulty(environment, i) for i in range(count)]
        fits += environment.valid[:count].tolist()
    return SettingProblems(
        setting=setting,
        experiment=experiment,
        problems=problems,
        fits=np.array(fits),
        difficulty=difficulty,
        simulator=simulator,
    )


def _tile_starts(setting: Setting, simulator: Simulator) -> range:
    return range(0, setting.scenario.worlds, simulator.tile)


def _measure_difficulty(environment: Environment, world: int) -> dict[str, float]:
    apart = np.asarray(environment.goal_m - environment.start_m)[world]
    return {
        "density": float(environment.density[world]),
        "path_ratio": float(environment.path_ratio[world].mean()),
        "free_lines": float(environment.line_free[world].mean()),
        "straight_m": float(np.linalg.norm(apart, axis=-1).sum()),
    }


def plan_problems(
    setting_problems: SettingProblems,
    planners: Sequence[tuple[int, ComparedPlanner]],
    store: BenchmarkStore,
    pool: Pool,
    close_after: int,
    advance: Callable[[int], None],
) -> None:
    """Have planners plan the problems that they have not answered yet.

    Args:
        setting_problems: the problems.
        planners: with their numbers in the database.
        store: where answers are kept.
        pool: where planners of the host plan.
        close_after: a planner without any plan for so many first problems is not asked the others;
            0: never.
        advance: called with the number of problems that are done or given up.
    """
    todo = {
        number: _find_unanswered(setting_problems, number, store, advance) for number, _ in planners
    }
    for number, planner in planners:
        if planner.policy is not None:
            for world in sorted(todo.pop(number)):
                _store_policy_run(setting_problems, number, world, store)
                advance(1)
    planners = [(number, planner) for number, planner in planners if number in todo]
    fitting = np.flatnonzero(setting_problems.fits).tolist()
    first = fitting[:close_after] if close_after else fitting
    for part in (first, fitting[len(first) :]):
        requests = []
        for number, planner in planners:
            worlds = [world for world in part if world in todo[number]]
            if (
                worlds
                and part is not first
                and _has_no_plans(setting_problems, number, store, first[-1])
            ):
                reason = f"no plan for any of its first {len(first)} problems here"
                store.close_problems(setting_problems.experiment, number, worlds, CLOSED, reason)
                advance(len(worlds))
            elif worlds:
                requests.append((number, planner, worlds))
        for number, planner, world, result in _collect_answers(setting_problems, requests, pool):
            _store_answer(setting_problems, number, world, _check_path_kind(result, planner), store)
            advance(1)


def _find_unanswered(
    setting_problems: SettingProblems,
    planner: int,
    store: BenchmarkStore,
    advance: Callable[[int], None],
) -> set[int]:
    """Problems that a planner is still to be asked."""
    where = (setting_problems.experiment, planner)
    done = {
        row["world"]
        for table in ("runs", "closed")
        for row in store.rows(
            f"SELECT world FROM {table} WHERE experimentid = ? AND plannerid = ?", where
        )
    }
    worlds = [world for world in range(len(setting_problems.problems)) if world not in done]
    no_room = [world for world in worlds if not setting_problems.fits[world]]
    store.close_problems(
        setting_problems.experiment, planner, no_room, NO_ROOM, "the world cannot hold the team"
    )
    advance(len(done) + len(no_room))
    return {world for world in worlds if setting_problems.fits[world]}


def _has_no_plans(
    setting_problems: SettingProblems, planner: int, store: BenchmarkStore, last: int
) -> bool:
    """Whether a planner has no plan for any problem up to the last of the first."""
    rows = store.rows(
        "SELECT count(*) AS runs, coalesce(sum(robots_planned), 0) AS paths FROM runs "
        "WHERE experimentid = ? AND plannerid = ? AND world <= ?",
        (setting_problems.experiment, planner, last),
    )
    return bool(rows[0]["runs"] and not rows[0]["paths"])


def _collect_answers(
    setting_problems: SettingProblems,
    requests: Sequence[tuple[int, ComparedPlanner, Sequence[int]]],
    pool: Pool,
) -> Iterator[tuple[int, ComparedPlanner, int, Answer]]:
    """Planner, world and answer, as they come; nobody is asked while a device plans."""
    compiled: dict[str, Compiled] = {}
    for number, planner, worlds in requests:
        if planner.on_device:
            for world, result in _plan_on_device(setting_problems, planner, worlds, compiled):
                yield number, planner, world, result
    tickets: dict[int, tuple[int, ComparedPlanner, int]] = {}
    for number, planner, worlds in requests:
        for world in worlds if not planner.on_device else ():
            ticket = pool.submit(
                setting_problems.problems[world], planner.spec_of(setting_problems.setting.scenario)
            )
            tickets[ticket] = number, planner, world
    for ticket, result in pool.completed(tickets):
        yield *tickets[ticket], result


def _check_path_kind(result: Answer, planner: ComparedPlanner) -> Answer:
    """An answer whose paths are all of the kind that the planner says it gives."""
    wrong = [
        path
        for path in result.paths
        if not isinstance(path, NoPlan | JointTrajectory if planner.joints else NoPlan | Trajectory)
    ]
    if not wrong:
        return result
    reason = f"gives {type(wrong[0]).__name__}, and its class says joints = {planner.joints}"
    paths = [NoPlan(reason) if any(path is x for x in wrong) else path for path in result.paths]
    none = all(isinstance(path, NoPlan) for path in paths)
    return replace(result, paths=paths, status="none" if none else "partial", reason=reason)


def _plan_on_device(
    setting_problems: SettingProblems,
    entry: ComparedPlanner,
    worlds: Sequence[int],
    programs: dict[str, Compiled],
) -> Iterator[tuple[int, Answer]]:
    """Answers of a planner that plans a batch: each took its share of the batch's time.

    Programs are shared by those that plan alike, and fly otherwise.
    """
    setting, simulator = setting_problems.setting, setting_problems.simulator
    shape = PathShape(points=setting.scenario.planner.points, joints=entry.joints)
    limit_s = DEADLINE_FACTOR * setting.scenario.planner.deadline_s
    extras = {}
    program_key = json.dumps([entry.name, entry.settings], sort_keys=True)
    for first in _tile_starts(setting, simulator):
        wanted = [world for world in worlds if first <= world < first + simulator.tile]
        if not wanted:
            continue
        sampled, problems = simulator.sample_problems(
            first, seed=setting.seed, information=setting.information
        )
        try:
            if program_key not in programs:
                begin = time.perf_counter()
                settings = problem_settings(setting.scenario, setting.information)
                planner = build_device_planner(entry.planner, settings)
                program = CompiledFunction(planner.plan_batch)
                programs[program_key] = program.lower(problems).compile()
                jax.block_until_ready(programs[program_key](problems))
                extras = {"warm_up_s": time.perf_counter() - begin}
            begin = time.perf_counter()
            path = jax.block_until_ready(programs[program_key](problems))
            seconds = time.perf_counter() - begin
            replace_paths(sampled, path, entry.label, shape)
            host = jax.device_get(path)
            teams = {
                w: [_extract_path(host, w - first, r) for r in range(setting.robots)]
                for w in wanted
            }
        except Exception as error:  # anybody's code: it is this planner's failure, and no more
            text = f"{type(error).__name__}: {' '.join(str(error).split())[:300]}"
            yield from ((w, failed_answer(setting.robots, "error", text, 0.0)) for w in wanted)
            continue
        mean_s = seconds / min(simulator.tile, setting.scenario.worlds)
        for world, paths in teams.items():
            if mean_s > limit_s:
                text = f"took {mean_s:.3g} s a problem; it had {limit_s / DEADLINE_FACTOR:g} s"
                yield world, failed_answer(setting.robots, "timeout", text, mean_s)
            else:
                yield (
                    world,
                    check_answer(
                        paths,
                        setting_problems.problems[world],
                        mean_s,
                        extras,
                        shape.points,
                        any_speed=True,
                    ),
                )
            extras = {}


def _extract_path(host: Plan, world: int, robot: int) -> Path | NoPlan:
    """The path of one robot out of a batch, without the rows that repeat its last."""
    path: Plan = jax.tree.map(lambda leaf: leaf[world, robot], host)
    if not bool(plans.is_found(path)):
        return NoPlan("no way found")
    differing = np.flatnonzero(path.time_s != path.time_s[-1])
    end = int(differing[-1]) + 2 if len(differing) else 2
    cut = {
        name: getattr(path, name)[:end]
        for name in ("time_s", "position_m", "position", "velocity", "acceleration", "degree")
        if hasattr(path, name) and np.ndim(getattr(path, name)) > 0
    }
    kept: Path = replace(path, **cut)
    return kept


def _store_answer(
    setting_problems: SettingProblems,
    planner: int,
    world: int,
    result: Answer,
    store: BenchmarkStore,
) -> None:
    has_path = any(not isinstance(path, NoPlan) for path in result.paths)
    row = {
        **_unflown_columns(setting_problems, world),
        **measure_answer(result),
        "plan_reason": result.reason or None,
        **({} if has_path else {"flown": False}),
    }
    store.add(
        setting_problems.experiment,
        planner,
        world,
        result.status,
        row,
        bytes_of.pack_paths(result.paths) if has_path else None,
        result.progress,
    )


def _store_policy_run(
    setting_problems: SettingProblems, planner: int, world: int, store: BenchmarkStore
) -> None:
    """A run of a policy, to be flown."""
    row = {**_unflown_columns(setting_problems, world), "planned": False, "robots_planned": 0}
    store.add(setting_problems.experiment, planner, world, POLICY, row, None)


def _unflown_columns(setting_problems: SettingProblems, world: int) -> dict[str, object]:
    return {
        **dict.fromkeys(TEXT_COLUMNS),
        **setting_problems.difficulty[world],
        "success": False,
        "reached": False,
        "robots_reached": 0,
    }
