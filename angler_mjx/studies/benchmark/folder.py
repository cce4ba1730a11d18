"""Results folder of a benchmark.

``benchmark.toml`` (as it was given), ``resolved.json``, ``environment.json``, ``inputs/`` copies of
vehicle, thruster and planner files, ``results.sqlite``; at the end ``about.json``, Parquet
tables, ``examples/``, ``figures/`` and ``report.html``. While it is made, it is hidden
(``.NAME.partial``).
"""

import shutil
from functools import partial
from pathlib import Path
from typing import Any

from angler_mjx.errors import ConfigError
from angler_mjx.runs.provenance import describe_environment
from angler_mjx.runs.resumable_folder import ResumableFolder
from angler_mjx.runs.storage import input_copies, results_folder
from angler_mjx.runs.storage.atomic_files import write_json
from angler_mjx.runs.storage.folder import ENVIRONMENT
from angler_mjx.runs.storage.read_errors import read_table, wrap_read_errors
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.studies.benchmark import problem_settings
from angler_mjx.studies.benchmark.config import BenchmarkConfig
from angler_mjx.studies.benchmark.problem_settings import Benchmark
from angler_mjx.studies.benchmark.store import FILE, BenchmarkStore

SOURCE, RESOLVED, ABOUT = "benchmark.toml", "resolved.json", "about.json"


def declare_folder(benchmark: Benchmark, source: Path) -> ResumableFolder[None]:
    """Declare the folder of a benchmark.

    Args:
        benchmark: the benchmark.
        source: file or folder that it was read from.
    """

    def resume(building: Path) -> None:
        results_folder.require_same_request(
            building / RESOLVED,
            benchmark.resolved(),
            {"benchmark": BenchmarkConfig, "scenario": Scenario},
        )

    return ResumableFolder(
        kind="benchmark",
        request_file=RESOLVED,
        begin=partial(_write_inputs, benchmark, source),
        resume=resume,
        is_complete=lambda out: (out / ABOUT).is_file(),
        advise=results_folder.resumable_by(FILE),
    )


def _write_inputs(benchmark: Benchmark, source: Path, building: Path) -> None:
    """Write all inputs of a benchmark, and an empty database."""
    shutil.copyfile(source / SOURCE if source.is_dir() else source, building / SOURCE)
    vehicles = [entry.vehicle for s in benchmark.settings for entry in s.scenario.fleet]
    files = [
        (input_copies.PLANNER if entry.policy is None else input_copies.POLICY, entry.file)
        for entry in benchmark.planners
    ]
    planners = [(role, file) for role, file in dict.fromkeys(files) if file is not None]
    worlds = [input_copies.world_files(s.scenario.world) for s in benchmark.settings]
    seas = list(dict.fromkeys(entry for files in worlds for entry in files))
    input_copies.copy_inputs(building, vehicles, [*planners, *seas])
    write_json(building / ENVIRONMENT, describe_environment())
    write_json(building / RESOLVED, benchmark.resolved())
    unfinished = building / f".unfinished.{FILE}"
    BenchmarkStore(unfinished, new=True).close()
    unfinished.replace(building / FILE)  # a process killed before it leaves nothing to resume


def read_folder(folder: Path) -> Benchmark:
    """Read the benchmark of a results folder, with its copies of files.

    Raises:
        ConfigError: it is none, or is damaged.
    """
    if not (folder / RESOLVED).is_file():
        raise ConfigError(
            f"{folder}: is no results folder of a benchmark (no {RESOLVED} in it); give one, or a "
            "benchmark file (.toml)"
        )
    table = read_table(folder / RESOLVED)
    stored_inputs = input_copies.read_inputs(folder)
    inputs_folder = (folder / input_copies.INPUTS_FOLDER).resolve()
    planners = {
        entry.named: str(inputs_folder / entry.copy_path)
        for entry in stored_inputs
        if entry.role in (input_copies.PLANNER, input_copies.POLICY)
    }
    copies = input_copies.stand_ins(folder)
    with wrap_read_errors(folder / RESOLVED):
        scenario: dict[str, Any] = dict(table["scenario"])
        scenario["fleet"] = [
            {
                **entry,
                "vehicle": copies.get((input_copies.VEHICLE, entry["vehicle"]), entry["vehicle"]),
            }
            for entry in scenario["fleet"]
        ]
        config = table["benchmark"]
    return problem_settings.rebuild_benchmark(
        folder, {"benchmark": config, "scenario": scenario}, planners
    )


def write_about(benchmark: Benchmark, building: Path, *, complete: bool) -> None:
    """Say what stands in the folder, for those who draw it."""
    config = benchmark.config
    environment = read_table(building / ENVIRONMENT)
    table = {
        "name": config.name,
        "description": config.description,
        "deadline_s": config.deadline_s,
        "close_after": config.close_after,
        "problems": config.problems,
        "command": environment.pop("command", ""),
        "versions": environment.pop("versions", {}),
        "host": environment,
        "planners": [
            {
                "label": planner.label,
                "name": planner.name,
                "settings": planner.settings,
                "online": dict(planner.online),
            }
            for planner in benchmark.planners
        ],
        "scenes": list(dict.fromkeys(setting.scene for setting in benchmark.settings)),
        "teams": sorted({setting.robots for setting in benchmark.settings}),
        "complete": complete,
    }
    write_json(building / ABOUT, table)
