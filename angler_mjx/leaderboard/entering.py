"""Submissions of the package's planners: plans of all problems and a card, by one command."""

import json
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import jax
import numpy as np

from angler_mjx.errors import AnglerError, ConfigError
from angler_mjx.files import parse_model
from angler_mjx.leaderboard import problem_files, problem_sets, submission
from angler_mjx.leaderboard.checking import limit_information
from angler_mjx.leaderboard.problem_files import ProblemManifest
from angler_mjx.leaderboard.problem_sets import FrozenBenchmark, ProblemSet
from angler_mjx.planning.device_planner import build_device_planner
from angler_mjx.planning.register import PlannerSpec
from angler_mjx.progress import Progress
from angler_mjx.robot.control import plans
from angler_mjx.runs.provenance import processor_name
from angler_mjx.runs.simulator.compilation import CompiledFunction
from angler_mjx.runs.simulator.host_planning import PlanNotes, planning_status
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.runs.simulator.world_preparation import (
    check_planner,
    problem_settings,
    replace_paths,
)
from angler_mjx.runs.storage import output_lock
from angler_mjx.runs.storage.atomic_files import write_text
from angler_mjx.runs.storage.plans import write as plan_writer
from angler_mjx.scenario.editing import scenario_table
from angler_mjx.scenario.scenario import Scenario


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
        "machine": processor_name(),
        "sets": list(sets),
    }
    text = "\n".join(
        f"{key} = {json.dumps(value, ensure_ascii=False)}" for key, value in card.items()
    )
    _write_card(out / submission.CARD, text + "\n")
    progress.start(sum(entry.problems for entry in entries), unit="problems")
    for entry in entries:
        path = out / submission.PLANS / f"{entry.name}.zarr"
        if not path.exists():
            progress.describe(entry.name)
            scenario = _plannable_scenario(benchmark, entry, manifest, secret, planner)
            _plan_set(path, scenario, workers)
        progress.advance(entry.problems)


def _write_card(path: Path, text: str) -> None:
    if path.exists() and path.read_text(encoding="utf-8") != text:
        raise ConfigError(f"{path}: is the card of another submission; choose another folder")
    write_text(path, text)


def _plannable_scenario(
    benchmark: FrozenBenchmark,
    entry: ProblemSet,
    manifest: ProblemManifest,
    secret: bytes,
    planner: Mapping[str, object],
) -> Scenario:
    """Return the scenario of a set with a planner, at the highest level that the planner can use.

    Raises:
        ConfigError: it cannot plan these problems at any level.
    """
    attempt = manifest.find(entry.name).attempt
    scenario = problem_files.build_set_scenario(benchmark, entry, attempt, secret)
    levels = scenario.planner.information.model_dump()
    asked = planner.get("information")
    wanted: Sequence[Mapping[str, str] | None] = (
        [asked] if isinstance(asked, Mapping) else [None, {**levels, "current": "nothing"}]
    )
    refusal: AnglerError | None = None
    for level in wanted:
        table = scenario_table(scenario)
        table["planner"] = {
            **table["planner"],
            **planner,
            "information": limit_information(levels, level),
        }
        changed = parse_model(Scenario, table, source=f"planner ({entry.name})")
        try:
            check_planner(changed)
        except ConfigError as error:
            refusal = error
            continue
        return changed
    raise ConfigError(f"{entry.name}: {refusal}")


def _plan_set(path: Path, scenario: Scenario, workers: int | None) -> None:
    """Plan the worlds of a set; one that was interrupted is continued."""
    simulator = Simulator(scenario, devices=1, workers=workers)
    try:
        is_begun = output_lock.partial_path(path).exists()
        spec = scenario.planner.planner_spec()
        if spec.reference.on_device:
            _plan_on_device(path, scenario, spec, simulator, resume=is_begun)
        else:
            plan_writer.plan_worlds(path, scenario, simulator, resume=is_begun)
    finally:
        simulator.close()


def _plan_on_device(
    path: Path, scenario: Scenario, spec: PlannerSpec, simulator: Simulator, *, resume: bool
) -> None:
    """Plan all problems of a set at once, timed after compiling; each took its part of the time."""
    worlds, problems = simulator.sample_problems(0)
    information = scenario.planner.information.to_information()
    planner = build_device_planner(spec, problem_settings(scenario, information))
    program = CompiledFunction(planner.plan_batch).lower(problems).compile()
    jax.block_until_ready(program(problems))
    begin = time.perf_counter()
    planned = jax.block_until_ready(program(problems))
    seconds = (time.perf_counter() - begin) / scenario.worlds
    replace_paths(worlds, planned, scenario.planner.name, simulator.paths)
    paths = jax.tree.map(lambda leaf: np.asarray(leaf)[: scenario.worlds], planned)
    is_found = np.asarray(plans.is_found(paths))
    writer = plan_writer.open_writer(
        path, scenario, simulator.paths, resume=resume, tile=scenario.worlds
    )
    with writer.keeping():
        notes = PlanNotes(
            planning_s=np.full(scenario.worlds, seconds),
            status=planning_status(is_found),
            reason=np.where(is_found, "", "no way found").astype(object),
        )
        writer.write(0, paths, notes)
        writer.publish()
