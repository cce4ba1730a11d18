"""A whole benchmark: setting by setting its problems are drawn, planned, and the plans are flown.

Planners are asked one at a time on each core, while nothing else is computed: what they take is
then their own time. Each answer and each flight is in the database before the next is waited for.
"""

import gc
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import jax
import numpy as np

from angler_mjx.errors import ConfigError, RunError
from angler_mjx.planning.host.pool import Pool
from angler_mjx.planning.planner import PathShape
from angler_mjx.runs.provenance import describe_environment
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.runs.storage import output_lock, planned
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.sim.information import Information
from angler_mjx.studies.benchmark import flying, folder, planning, questions, scenery, tables
from angler_mjx.studies.benchmark.columns import POLICY
from angler_mjx.studies.benchmark.compared_planners import ComparedPlanner
from angler_mjx.studies.benchmark.questions import Benchmark, Setting
from angler_mjx.studies.benchmark.report import page
from angler_mjx.studies.benchmark.store import FILE, STATUS, BenchmarkStore


class BenchmarkProgress(Protocol):
    """What a benchmark tells while it goes on."""

    def start(self, runs: int) -> None:
        """So many runs are to be made, or were made before."""

    def at(self, text: str) -> None:
        """What is being done."""

    def advance(self, runs: int) -> None:
        """So many runs more are planned, were planned before, or will not be asked."""


@dataclass(kw_only=True)
class _Simulators:
    """Compiled simulators of the scenario that is worked on."""

    scenario: Scenario | None = None
    made: dict[tuple[bool, str, Information | None], Simulator] = field(default_factory=dict)

    def of(self, setting: Setting, joints: bool, one: ComparedPlanner | None = None) -> Simulator:
        """For paths of joints or not, flown as they are, or as a contestant flies."""
        if self.scenario is not setting.scenario:
            self.scenario, self.made = setting.scenario, {}
            # Programs of hundreds of settings are more than a process may map into its memory.
            gc.collect()
            jax.clear_caches()
        own = None if one is None or not one.flies_itself else one
        key = (joints, "" if own is None else own.label, None if own is None else setting.knows)
        if key not in self.made:
            shape = PathShape(points=setting.scenario.planner.points, joints=joints)
            flown = setting.scenario if own is None else setting.flown(own)
            simulator = Simulator(flown, paths=shape)
            simulator.compile()
            self.made[key] = simulator
        return self.made[key]


def read(source: Path, **instead: Any) -> Benchmark:
    """A benchmark from its file, or from the results folder of one that is to be made again.

    Args:
        source: the file or the folder.
        **instead: top-level keys that replace those of the file.

    Raises:
        ConfigError: naming the faults; or keys are given with a folder.
        UnsupportedError: the libraries of a planner are not installed.
    """
    if source.is_dir() and instead:
        raise ConfigError(
            f"{source}: is made again as it was; leave out {', '.join(instead)}, or give the "
            "benchmark file"
        )
    return folder.read(source) if source.is_dir() else questions.read(source, **instead)


def run(
    benchmark: Benchmark,
    source: Path,
    out: Path,
    *,
    workers: Callable[[], Pool],
    resume: bool = False,
    told: BenchmarkProgress,
) -> None:
    """Make the results folder of a benchmark.

    Args:
        benchmark: to be run.
        source: that it was read from.
        out: results folder.
        workers: makes the pool in which planners of the host plan.
        resume: go on with one that was interrupted.
        told: what to tell meanwhile.

    Raises:
        ConfigError: the folder is taken, or there is nothing to go on with.
        RunError: the disk is full, or no worker can be started.
        KeyboardInterrupt: interrupted; what was finished is kept.
    """
    with workers() as pool:  # before anything is made: a cluster may not answer
        _run(benchmark, source, out, pool, resume, told)


def _run(
    benchmark: Benchmark, source: Path, out: Path, pool: Pool, resume: bool, told: BenchmarkProgress
) -> None:
    claimed = folder.reopen(benchmark, out) if resume else folder.begin(benchmark, source, out)
    building = claimed.building
    try:
        with BenchmarkStore(building / FILE) as store:
            _all(benchmark, store, pool, told)
            told.at("tables and page")
            _results(benchmark, building, store, complete=True)
        claimed.publish()
    except OSError as error:
        claimed.release()
        raise RunError(
            f"{out}: cannot be written ({error.strerror or error}); make room and go on with "
            "--resume"
        ) from error
    except BaseException:
        claimed.release()
        raise


def report(place: Path) -> Path:
    """Make tables, figures and page of a results folder anew; returns the page.

    Raises:
        ConfigError: it is none.
    """
    benchmark = folder.read(place)
    complete = not place.name.startswith(output_lock.PREFIX)
    with BenchmarkStore(place / FILE) as store:
        _results(benchmark, place, store, complete=complete)
    return place / "report.html"


def summary(place: Path) -> str:
    """Return how the planners of a results folder did: a line each, and why teams have no plan."""
    with BenchmarkStore(place / FILE, only_read=True) as store:
        planning = _planning(store)
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
        lines += [f"  {line}" for line in planned.lines(planning.get(row["name"]), "team")]
    return "\n".join(lines)


def fault(place: Path) -> str | None:
    """Return why nothing was planned, where every planner raised in every problem; else None."""
    with BenchmarkStore(place / FILE, only_read=True) as store:
        faults = [planned.fault(one) for one in _planning(store).values()]
    return faults[0] if faults and all(faults) else None


def _planning(store: BenchmarkStore) -> dict[str, dict[str, Any]]:
    """How planning ended, by the planner's name; a team that is planned for in part has no plan."""
    by_planner: dict[str, list[Any]] = {}
    for row in store.rows(
        "SELECT name, runs.id AS run, solved, status, plan_reason FROM runs "
        "JOIN plannerConfigs ON plannerConfigs.id = plannerid "
        "JOIN words ON words.runid = runs.id ORDER BY runs.id"
    ):
        if STATUS[row["status"]] != POLICY:
            by_planner.setdefault(row["name"], []).append(row)
    return {
        name: planned.of_robots(
            np.array([row["run"] for row in rows]),
            np.array([bool(row["solved"]) for row in rows]),
            [STATUS[row["status"]] for row in rows],
            [row["plan_reason"] for row in rows],
        )
        for name, rows in by_planner.items()
    }


def _results(benchmark: Benchmark, place: Path, store: BenchmarkStore, *, complete: bool) -> None:
    tables.write(store, place)
    scenery.write(store, place)
    folder.about(benchmark, place, complete=complete)
    page.make(place)


def _all(benchmark: Benchmark, store: BenchmarkStore, pool: Pool, told: BenchmarkProgress) -> None:
    total = sum(
        setting.scenario.worlds * len(benchmark.asked(setting)) for setting in benchmark.settings
    )
    told.start(total)
    simulators = _Simulators()
    about = _about()
    for setting in benchmark.settings:
        begin = time.perf_counter()
        experiment = store.setting(setting, about)
        asked = [(store.contestant(one), one) for one in benchmark.asked(setting)]
        if _is_done(setting, experiment, asked, store):
            told.advance(setting.scenario.worlds * len(asked))
            continue
        _one(benchmark, setting, experiment, asked, simulators, store, pool, told)
        store.add_time(experiment, time.perf_counter() - begin)


def _one(
    benchmark: Benchmark,
    setting: Setting,
    experiment: int,
    asked: Sequence[tuple[int, ComparedPlanner]],
    simulators: _Simulators,
    store: BenchmarkStore,
    pool: Pool,
    told: BenchmarkProgress,
) -> None:
    config = benchmark.config
    told.at(f"{setting}: compiling")
    joints = [one.joints for _, one in asked]
    simulator = simulators.of(setting, all(joints))
    problems = planning.ask(setting, simulator, experiment)
    examples = min(config.examples, setting.scenario.worlds)
    for world in range(examples):
        store.add_scenery(experiment, world, scenery.of(problems.problems[world]))
    told.at(f"{setting}: planning")
    planning.plan(problems, asked, store, pool, config.close_after, told.advance)
    for kind in sorted(set(joints)):
        told.at(f"{setting}: flying")
        numbers = [n for n, one in asked if one.joints == kind and not one.flies_itself]
        flights = flying.to_fly(experiment, numbers, store)
        if flights:
            flying.fly(setting, simulators.of(setting, kind), flights, examples, store)
    for number, one in asked:
        flights = flying.to_fly(experiment, [number], store) if one.flies_itself else []
        if flights:
            told.at(f"{setting}: flying {one.label}")
            simulator = simulators.of(setting, one.joints, one)
            flying.fly(setting, simulator, flights, examples, store)


def _is_done(
    setting: Setting,
    experiment: int,
    asked: Sequence[tuple[int, ComparedPlanner]],
    store: BenchmarkStore,
) -> bool:
    """Whether all runs of a setting are planned and flown."""
    done = store.rows(
        "SELECT (SELECT count(*) FROM runs WHERE experimentid = :id AND flown IS NOT NULL) + "
        "(SELECT count(*) FROM closed WHERE experimentid = :id) AS done",
        {"id": experiment},
    )
    return bool(done[0]["done"] >= setting.scenario.worlds * len(asked))


def _about() -> dict[str, Any]:
    """OMPL's columns of an experiment that are the same for all."""
    made = describe_environment()
    return {
        "version": f"angler_mjx {made['versions']['angler-mjx'] or '0.0.0'}",
        "hostname": made["platform"],
        "cpuinfo": f"{made['cpu_count']} processors; {made['device']}",
        "date": time.strftime("%Y-%m-%d %H:%M:%S"),
        "totaltime": 0.0,
    }
