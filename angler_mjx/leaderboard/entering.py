"""Submissions of the package's planners: plans of all problems and a card, by one command."""

import fcntl
import json
import tempfile
import time
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import jax
import numpy as np

from angler_mjx.errors import ConfigError
from angler_mjx.files import parse_model
from angler_mjx.leaderboard import problem_files, problem_sets, submission
from angler_mjx.leaderboard.problem_files import ProblemManifest
from angler_mjx.leaderboard.problem_sets import ProblemSet
from angler_mjx.leaderboard.set_scenarios import build_planned_scenario
from angler_mjx.leaderboard.submission import Card
from angler_mjx.planning import register
from angler_mjx.planning.device_planner import build_device_planner
from angler_mjx.planning.problem import Problem
from angler_mjx.progress import Progress
from angler_mjx.robot.control import plans
from angler_mjx.robot.control.plans import Plan
from angler_mjx.runs.device_processes import map_on_devices
from angler_mjx.runs.provenance import processor_name
from angler_mjx.runs.simulator.compilation import CompiledFunction
from angler_mjx.runs.simulator.host_planning import PlanNotes, path_shape, planning_status
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.runs.simulator.world_preparation import (
    problem_settings,
    replace_paths,
)
from angler_mjx.runs.storage import output_lock
from angler_mjx.runs.storage.atomic_files import write_text
from angler_mjx.runs.storage.plans import write as plan_writer
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.sim.state import World
from angler_mjx.studies.speed.measured import graph_search

type PlanBatch = Callable[[Problem], Plan]
"""Compiled planner of a batch of one problem."""


def plan_submission(
    out: Path,
    planner: Mapping[str, object],
    progress: Progress,
    *,
    manifest: ProblemManifest,
    name: str,
    sets: tuple[str, ...] = (),
    secret: bytes = problem_sets.PUBLIC,
    workers: int | None = None,
    processes: int = 1,
) -> None:
    """Plan the problems with a planner; sets that are planned already are kept.

    Args:
        out: folder of the submission, new or of an interrupted call.
        planner: keys of a scenario's ``planner``.
        progress: receives the progress, in problems.
        manifest: of the problems.
        name: on the board.
        sets: sets or parts of names that are entered; all if left out.
        secret: that the problems' seeds were made with; empty for the public ones.
        workers: planning processes, for planners of the host.
        processes: processes that compile planners of a device side by side; they are timed one by
            one all the same.

    Raises:
        ConfigError: the planner cannot be used, or the folder holds another submission.
        RunError: the disk gave out.
    """
    benchmark = problem_sets.load_benchmark()
    entries = problem_sets.select_problem_sets(benchmark, sets)
    (out / submission.PLANS).mkdir(parents=True, exist_ok=True)
    card = {
        "schema_version": 1,
        "benchmark": benchmark.title,
        "name": name,
        "authors": [],
        "description": f"planner {json.dumps(dict(planner))}",
        "kind": "plans",
        "machine": _name_machine(planner),
        "sets": list(sets),
    }
    factor = _write_card(out / submission.CARD, card, planner)
    progress.start(sum(entry.problems for entry in entries), unit="problems")
    waiting = []
    for entry in entries:
        if (out / submission.PLANS / f"{entry.name}.zarr").exists():
            progress.advance(entry.problems)
        else:
            waiting.append(entry)
    parts = [
        SetToPlan(
            entry=entry,
            path=out / submission.PLANS / f"{entry.name}.zarr",
            scenario=build_planned_scenario(
                scenario, {**planner, "deadline_s": factor * entry.limit_s}, "planner"
            ),
            seed=problem_files.printed_seed(scenario, secret),
        )
        for entry in waiting
        for scenario in [
            problem_files.build_set_scenario(
                benchmark, entry, manifest.find(entry.name).attempt, secret
            )
        ]
    ]
    _plan_sets(parts, processes, workers, progress)


@dataclass(frozen=True, kw_only=True)
class SetToPlan:
    """A set without a file of plans."""

    entry: ProblemSet
    path: Path
    """Of the file to make."""
    scenario: Scenario
    """With the planner."""
    seed: int
    """That the file states."""

    @property
    def kind(self) -> Hashable:
        """Value that is equal for sets that may need the same program of a planner."""
        information = self.scenario.planner.information.to_information()
        settings = problem_settings(self.scenario, information)
        return self.entry.robots, self.entry.condition, settings


def _write_card(path: Path, card: dict[str, Any], planner: Mapping[str, object]) -> float:
    """Write the card, or find it there; returns its ``machine_factor``.

    Raises:
        ConfigError: there is the card of another submission.
    """
    if path.exists():
        stored = submission.read_card(path.parent)
        wanted = parse_model(Card, card, source=str(path))
        names = [name for name in card if getattr(stored, name) != getattr(wanted, name)]
        if names:
            raise ConfigError(
                f"{path}: is the card of another submission ({', '.join(names)} would differ); "
                "choose another folder"
            )
        return stored.machine_factor
    factor = round(_measure_factor(planner), 3)
    lines = [
        f"{key} = {json.dumps(value, ensure_ascii=False)}"
        for key, value in {**card, "machine_factor": factor}.items()
    ]
    write_text(path, "\n".join(lines) + "\n")
    return factor


def _measure_factor(planner: Mapping[str, object]) -> float:
    """Return the factor of this machine; 1 for planners on an accelerator."""
    return 1.0 if _uses_accelerator(planner) else graph_search.measure_time_factor()


def _name_machine(planner: Mapping[str, object]) -> str:
    """Return the name of the accelerator or processor that plans."""
    return jax.devices()[0].device_kind if _uses_accelerator(planner) else processor_name()


def _uses_accelerator(planner: Mapping[str, object]) -> bool:
    return register.find(str(planner["name"])).on_device and jax.default_backend() != "cpu"


def _plan_sets(
    parts: Sequence[SetToPlan], processes: int, workers: int | None, progress: Progress
) -> None:
    """Plan sets; planners of a device are timed one by one, in however many processes."""
    if parts and not parts[0].scenario.planner.planner_spec().reference.on_device:
        for part in parts:
            progress.describe(part.entry.name)
            _plan_on_host(part, workers)
            progress.advance(part.entry.problems)
        return
    groups: dict[Hashable, list[SetToPlan]] = {}
    for part in parts:
        groups.setdefault(part.kind, []).append(part)
    with tempfile.NamedTemporaryFile() as file:
        lock = Path(file.name)
        if processes < 2:
            for group in groups.values():
                programs: dict[Hashable, PlanBatch] = {}
                for part in group:
                    progress.describe(part.entry.name)
                    _plan_timed_alone(part, programs, lock)
                    progress.advance(part.entry.problems)
            return
        # Large teams take longest: they begin first.
        ordered = sorted(groups.values(), key=lambda group: -group[0].entry.robots)
        plan = partial(_plan_alike, lock=lock)
        planned = map_on_devices(plan, ordered, min(processes, len(ordered)), __name__)
        for group, _ in zip(ordered, planned, strict=True):
            progress.describe(group[-1].entry.name)
            progress.advance(sum(part.entry.problems for part in group))


def _plan_alike(parts: Sequence[SetToPlan], lock: Path) -> None:
    """Plan sets that may share programs."""
    programs: dict[Hashable, PlanBatch] = {}
    for part in parts:
        _plan_timed_alone(part, programs, lock)


def _plan_timed_alone(part: SetToPlan, programs: dict[Hashable, PlanBatch], lock: Path) -> None:
    """Plan a set; processes with the same lock call their planners one after another."""
    planner = _compile_planner(part, programs)
    with lock.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)  # released as the file is closed
        planner.write_plans(part)


def _plan_on_host(part: SetToPlan, workers: int | None) -> None:
    """Plan the worlds of a set; one that was interrupted is continued."""
    simulator = Simulator(part.scenario, devices=1, workers=workers)
    try:
        is_begun = output_lock.partial_path(part.path).exists()
        plan_writer.plan_worlds(
            part.path, part.scenario, simulator, resume=is_begun, seed=part.seed
        )
    finally:
        simulator.close()


@dataclass(frozen=True, kw_only=True)
class LoadedPlanner:
    """Compiled planner of a set, and the problems of the set."""

    simulator: Simulator
    worlds: World
    problems: Problem
    plan_batch: PlanBatch
    is_new: bool
    """Whether the planner was not called yet."""

    def write_plans(self, part: SetToPlan) -> None:
        """Plan the problems of the set one after another, each timed."""
        count = part.scenario.worlds
        if self.is_new:  # the first call loads the program
            jax.block_until_ready(self.plan_batch(_select_problem(self.problems, 0)))
        planned, planning_s = [], np.zeros(count)
        for world in range(count):
            problem = _select_problem(self.problems, world)
            begin = time.perf_counter()
            planned.append(jax.block_until_ready(self.plan_batch(problem)))
            planning_s[world] = time.perf_counter() - begin
        paths: Plan = jax.tree.map(lambda *rows: np.concatenate(rows), *planned)
        worlds = jax.tree.map(lambda leaf: leaf[:count], self.worlds)
        name, shape = part.scenario.planner.name, self.simulator.paths
        replace_paths(worlds, paths, name, shape)
        is_found = np.asarray(plans.is_found(paths))
        is_begun = output_lock.partial_path(part.path).exists()
        writer = plan_writer.open_writer(
            part.path, part.scenario, shape, resume=is_begun, tile=count, seed=part.seed
        )
        with writer.keeping():
            notes = PlanNotes(
                planning_s=planning_s,
                status=planning_status(is_found),
                reason=np.where(is_found, "", "no way found").astype(object),
            )
            writer.write(0, paths, notes)
            writer.publish()
        self.simulator.close()


def _select_problem(problems: Problem, world: int) -> Problem:
    """Return one problem of a batch as a batch of one, on the device."""
    alone: Problem = jax.tree.map(lambda leaf: leaf[world : world + 1], problems)
    jax.block_until_ready(alone)
    return alone


def _compile_planner(part: SetToPlan, programs: dict[Hashable, PlanBatch]) -> LoadedPlanner:
    """Sample the problems of a set, and compile its planner unless there is one for such problems.

    Args:
        part: the set.
        programs: compiled planners by settings and shapes of their problems; a new one is added.
    """
    scenario = part.scenario
    spec = scenario.planner.planner_spec()
    shape = path_shape(spec, scenario.planner.points, scenario.joint_names())
    # Given the shape of paths, it samples worlds without the planner.
    simulator = Simulator(scenario, devices=1, paths=shape)
    worlds, problems = simulator.sample_problems(0)
    problem = _select_problem(problems, 0)
    leaves, structure = jax.tree.flatten(problem)
    traced = (structure, tuple((leaf.shape, leaf.dtype) for leaf in leaves))
    is_new = traced not in programs
    if is_new:
        settings = problem_settings(scenario, scenario.planner.information.to_information())
        planner = build_device_planner(spec, settings)
        programs[traced] = CompiledFunction(planner.plan_batch).lower(problem).compile()
    return LoadedPlanner(
        simulator=simulator,
        worlds=worlds,
        problems=problems,
        plan_batch=programs[traced],
        is_new=is_new,
    )
