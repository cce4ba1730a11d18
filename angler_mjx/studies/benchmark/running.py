"""A whole benchmark: setting by setting its problems are drawn, planned, and the plans are flown.

Planners are asked one at a time on each core, while nothing else is computed: what they take is
then their own time. Each answer and each flight is in the database before the next is waited for.
"""

import sqlite3
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from functools import partial
from pathlib import Path

import numpy as np

from angler_mjx.errors import ConfigError
from angler_mjx.planning.host.pool import Pool
from angler_mjx.planning.planner import PathShape
from angler_mjx.progress import Progress
from angler_mjx.runs.processes import OneProcess
from angler_mjx.runs.provenance import describe_environment
from angler_mjx.runs.resumable_folder import open_folder
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.runs.simulator_cache import SimulatorCache
from angler_mjx.runs.storage import output_lock, planning_summary
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.studies.benchmark import flying, folder, planning, problem_settings, scenery, tables
from angler_mjx.studies.benchmark.columns import POLICY
from angler_mjx.studies.benchmark.compared_planners import ComparedPlanner
from angler_mjx.studies.benchmark.problem_settings import Benchmark, Setting
from angler_mjx.studies.benchmark.report import page
from angler_mjx.studies.benchmark.store import FILE, STATUS, BenchmarkStore


def read_benchmark(
    source: Path, *, planners: Sequence[str] | None = None, **overrides: object
) -> Benchmark:
    """A benchmark from its file, or from the results folder of one that is to be made again.

    Args:
        source: the file or the folder.
        planners: names of the compared planners and policies; the file's if None.
        **overrides: top-level keys that replace those of the file.

    Raises:
        ConfigError: naming the faults; or keys are given with a folder.
        UnsupportedError: the libraries of a planner are not installed.
    """
    replaced = [*overrides, *([] if planners is None else ["planner"])]
    if source.is_dir() and replaced:
        raise ConfigError(
            f"{source}: is made again as it was; leave out {', '.join(replaced)}, or give the "
            "benchmark file"
        )
    return (
        folder.read_folder(source)
        if source.is_dir()
        else problem_settings.read_benchmark(source, planners=planners, **overrides)
    )


def run_benchmark(
    benchmark: Benchmark,
    source: Path,
    out: Path,
    *,
    workers: Callable[[], Pool],
    resume: bool = False,
    progress: Progress,
) -> None:
    """Make the results folder of a benchmark.

    Args:
        benchmark: to be run.
        source: that it was read from.
        out: results folder.
        workers: makes the pool in which planners of the host plan.
        resume: go on with one that was interrupted.
        progress: receives the progress.

    Raises:
        ConfigError: the folder is taken, or there is nothing to go on with.
        RunError: the disk is full, or no worker can be started.
        KeyboardInterrupt: interrupted; what was finished is kept.
    """
    declared = folder.declare_folder(benchmark, source)
    with (
        workers() as pool,  # before anything is made: a cluster may not answer
        open_folder(declared, out, resume=resume, processes=OneProcess()) as opened,
    ):
        opened.publish(partial(_fill_folder, benchmark, pool, progress))


def _fill_folder(benchmark: Benchmark, pool: Pool, progress: Progress, building: Path) -> None:
    """Plan and fly what is not in the database yet, and write tables and page."""
    with BenchmarkStore(building / FILE) as store, closing(SimulatorCache()) as simulators:
        _run_settings(benchmark, simulators, store, pool, progress)
        progress.describe("tables and page")
        _write_results(benchmark, building, store, complete=True)


def rebuild_report(results_folder: Path) -> Path:
    """Make tables, figures and page of a results folder anew; returns the page.

    Raises:
        ConfigError: it is none.
    """
    benchmark = folder.read_folder(results_folder)
    complete = not results_folder.name.startswith(output_lock.PREFIX)
    with BenchmarkStore(results_folder / FILE) as store:
        _write_results(benchmark, results_folder, store, complete=complete)
    return results_folder / "report.html"


def format_summary(results_folder: Path) -> str:
    """Return how the planners of a results folder did: a line each, and why teams have no plan."""
    with BenchmarkStore(results_folder / FILE, only_read=True) as store:
        planning = _summarise_planning(store)
        rows = store.rows(
            "SELECT name, count(*) AS runs, sum(solved) AS planned, sum(success) AS success, "
            "min(status) AS least, "
            "(SELECT count(*) FROM closed WHERE plannerid = plannerConfigs.id) AS closed "
            "FROM runs JOIN plannerConfigs ON plannerConfigs.id = plannerid "
            "GROUP BY plannerid ORDER BY plannerid"
        )
    lines = []
    for row in rows:
        lines.append(
            f"{row['name']}: {row['success']} of {row['runs']} teams all arrived"
            + ("" if STATUS[row["least"]] == POLICY else f", {row['planned']} planned")
            + (f"; {row['closed']} problems not asked" if row["closed"] else "")
        )
        lines += [
            f"  {line}" for line in planning_summary.reason_lines(planning.get(row["name"]), "team")
        ]
    return "\n".join(lines)


def find_planning_fault(results_folder: Path) -> str | None:
    """Return why nothing was planned, where every planner raised in every problem; else None."""
    with BenchmarkStore(results_folder / FILE, only_read=True) as store:
        faults = [
            planning_summary.planner_fault(planning)
            for planning in _summarise_planning(store).values()
        ]
    return faults[0] if faults and all(faults) else None


def _summarise_planning(store: BenchmarkStore) -> dict[str, planning_summary.PlanningSummary]:
    """How planning ended, by the planner's name; a team that is planned for in part has no plan."""
    by_planner: dict[str, list[sqlite3.Row]] = {}
    for row in store.rows(
        "SELECT name, runs.id AS run, solved, status, plan_reason FROM runs "
        "JOIN plannerConfigs ON plannerConfigs.id = plannerid "
        "JOIN words ON words.runid = runs.id ORDER BY runs.id"
    ):
        if STATUS[row["status"]] != POLICY:
            by_planner.setdefault(row["name"], []).append(row)
    return {
        name: planning_summary.summarise_robots(
            np.array([row["run"] for row in rows]),
            np.array([bool(row["solved"]) for row in rows]),
            [STATUS[row["status"]] for row in rows],
            [row["plan_reason"] for row in rows],
        )
        for name, rows in by_planner.items()
    }


def _write_results(
    benchmark: Benchmark, results_folder: Path, store: BenchmarkStore, *, complete: bool
) -> None:
    tables.write_tables(store, results_folder)
    scenery.write_examples(store, results_folder)
    folder.write_about(benchmark, results_folder, complete=complete)
    page.write_report(results_folder)


def _run_settings(
    benchmark: Benchmark,
    simulators: SimulatorCache,
    store: BenchmarkStore,
    pool: Pool,
    progress: Progress,
) -> None:
    total = sum(
        setting.scenario.worlds * len(benchmark.select_planners(setting))
        for setting in benchmark.settings
    )
    progress.start(total, unit="runs")
    about = _experiment_columns()
    scenario: Scenario | None = None
    for setting in benchmark.settings:
        begin = time.perf_counter()
        experiment = store.ensure_setting(setting, about)
        planners = [
            (store.ensure_planner(planner), planner)
            for planner in benchmark.select_planners(setting)
        ]
        if _is_done(setting, experiment, planners, store):
            progress.advance(setting.scenario.worlds * len(planners))
            continue
        if scenario is not setting.scenario:
            simulators.clear()
            scenario = setting.scenario
        _run_setting(benchmark, setting, experiment, planners, simulators, store, pool, progress)
        store.add_time(experiment, time.perf_counter() - begin)


def _find_simulator(
    simulators: SimulatorCache,
    setting: Setting,
    joints: bool,
    planner: ComparedPlanner | None = None,
) -> Simulator:
    """Return the simulator of a setting's scenario, or of the flights of a planner.

    Args:
        simulators: those of the scenario alone.
        setting: the setting.
        joints: whether paths are trajectories of joints.
        planner: planner or policy that flies otherwise than along the plans of the start.
    """
    scenario = setting.scenario if planner is None else setting.flown(planner)
    shape = PathShape(points=setting.scenario.planner.points, joints=joints)
    key = (joints, None) if planner is None else (joints, (planner.label, setting.information))
    return simulators.of(key, partial(Simulator, scenario, paths=shape))


def _run_setting(
    benchmark: Benchmark,
    setting: Setting,
    experiment: int,
    planners: Sequence[tuple[int, ComparedPlanner]],
    simulators: SimulatorCache,
    store: BenchmarkStore,
    pool: Pool,
    progress: Progress,
) -> None:
    config = benchmark.config
    progress.describe(f"{setting}: compiling")
    joints = [planner.joints for _, planner in planners]
    simulator = _find_simulator(simulators, setting, all(joints))
    problems = planning.sample_problems(setting, simulator, experiment)
    examples = min(config.examples, setting.scenario.worlds)
    for world in range(examples):
        store.add_scenery(experiment, world, scenery.pack_scenery(problems.problems[world]))
    progress.describe(f"{setting}: planning")
    planning.plan_problems(problems, planners, store, pool, config.close_after, progress.advance)
    for kind in sorted(set(joints)):
        progress.describe(f"{setting}: flying")
        numbers = [
            n for n, planner in planners if planner.joints == kind and not planner.flies_itself
        ]
        flights = flying.find_unflown_plans(experiment, numbers, store)
        if flights:
            simulator = _find_simulator(simulators, setting, kind)
            flying.fly_plans(setting, simulator, flights, examples, store)
    for number, planner in planners:
        flights = (
            flying.find_unflown_plans(experiment, [number], store) if planner.flies_itself else []
        )
        if flights:
            progress.describe(f"{setting}: flying {planner.label}")
            simulator = _find_simulator(simulators, setting, planner.joints, planner)
            flying.fly_plans(setting, simulator, flights, examples, store)


def _is_done(
    setting: Setting,
    experiment: int,
    planners: Sequence[tuple[int, ComparedPlanner]],
    store: BenchmarkStore,
) -> bool:
    """Whether all runs of a setting are planned and flown."""
    done = store.rows(
        "SELECT (SELECT count(*) FROM runs WHERE experimentid = :id AND flown IS NOT NULL) + "
        "(SELECT count(*) FROM closed WHERE experimentid = :id) AS done",
        {"id": experiment},
    )
    return bool(done[0]["done"] >= setting.scenario.worlds * len(planners))


def _experiment_columns() -> dict[str, object]:
    """OMPL's columns of an experiment that are the same for all."""
    environment = describe_environment()
    return {
        "version": f"angler_mjx {environment['versions']['angler-mjx'] or '0.0.0'}",
        "hostname": environment["platform"],
        "cpuinfo": f"{environment['cpu_count']} processors; {environment['device']}",
        "date": time.strftime("%Y-%m-%d %H:%M:%S"),
        "totaltime": 0.0,
    }
