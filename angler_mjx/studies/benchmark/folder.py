"""The results folder of a benchmark: its files, made once and gone on with.

``benchmark.toml`` (as it was given), ``resolved.json``, ``environment.json``, ``inputs/`` copies of
vehicle, thruster and planner files, ``results.sqlite``; at the end ``about.json``, Parquet tables,
``examples/``, ``figures/`` and ``report.html``. While it is made, it is hidden
(``.NAME.partial``).
"""

import json
import shutil
from pathlib import Path
from typing import Any

from angler_mjx.errors import ConfigError, RunError
from angler_mjx.runs.provenance import describe_environment
from angler_mjx.runs.storage import atomic, inputs, output_lock
from angler_mjx.runs.storage.damage import read_table, reading
from angler_mjx.runs.storage.folder import ENVIRONMENT, write_json
from angler_mjx.runs.storage.output_lock import OutputLock
from angler_mjx.scenario.editing import first_difference
from angler_mjx.studies.benchmark import questions
from angler_mjx.studies.benchmark.questions import Benchmark
from angler_mjx.studies.benchmark.store import FILE, BenchmarkStore

SOURCE, RESOLVED, ABOUT = "benchmark.toml", "resolved.json", "about.json"
WHAT = "benchmark"


def begin(benchmark: Benchmark, source: Path, out: Path) -> OutputLock:
    """A new folder, with all that the benchmark is made of.

    Raises:
        ConfigError: the name is taken.
        RunError: it cannot be written.
    """
    claimed = output_lock.acquire(out, what=WHAT, left=_worth)
    building = claimed.building
    try:
        shutil.copyfile(source / SOURCE if source.is_dir() else source, building / SOURCE)
        vehicles = [one.vehicle for s in benchmark.settings for one in s.scenario.fleet]
        files = [one.file for one in benchmark.contestants]
        planners = [(inputs.PLANNER, file) for file in dict.fromkeys(files) if file is not None]
        worlds = [inputs.of_world(s.scenario.world) for s in benchmark.settings]
        seas = list(dict.fromkeys(one for files in worlds for one in files))
        inputs.take(building, vehicles, [*planners, *seas])
        write_json(building / ENVIRONMENT, describe_environment())
        write_json(building / RESOLVED, benchmark.resolved())
        unfinished = building / f".unfinished.{FILE}"
        BenchmarkStore(unfinished, new=True).close()
        unfinished.replace(building / FILE)  # who is killed before leaves nothing to go on with
    except OSError as error:
        claimed.withdraw()
        raise RunError(f"--out {out}: cannot be written ({error.strerror or error})") from error
    except BaseException:
        claimed.withdraw()
        raise
    return claimed


def _worth(building: Path) -> str | None:
    return output_lock.RESUMABLE if (building / FILE).exists() else None


def reopen(benchmark: Benchmark, out: Path) -> OutputLock:
    """Take up a folder that was interrupted.

    Raises:
        ConfigError: there is none, it is finished, or it is of another benchmark.
    """
    if (out / ABOUT).is_file():
        raise ConfigError(f"--resume: {out} is complete; nothing is left to do")
    claimed = output_lock.acquire_unfinished(out, what=WHAT)
    if claimed is None:
        raise ConfigError(f"--resume: there is no interrupted benchmark {out}")
    try:
        then = read_table(claimed.building / RESOLVED)
        other = first_difference(benchmark.resolved(), then)
        if other is not None:
            raise ConfigError(
                f"--resume: {out} was begun with another {other}; put the old value back (see "
                f"{claimed.building / RESOLVED}), or begin a new benchmark with --out"
            )
    except BaseException:
        claimed.release()
        raise
    return claimed


def read(folder: Path) -> Benchmark:
    """The benchmark of a results folder, with the files that it keeps copies of.

    Raises:
        ConfigError: it is none, or is damaged.
    """
    if not (folder / RESOLVED).is_file():
        raise ConfigError(
            f"{folder}: is no results folder of a benchmark (no {RESOLVED} in it); give one, or a "
            "benchmark file (.toml)"
        )
    table = read_table(folder / RESOLVED)
    kept = inputs.read_inputs(folder)
    place = (folder / inputs.FOLDER).resolve()
    planners = {one.named: str(place / one.copy_path) for one in kept if one.role == inputs.PLANNER}
    instead = inputs.stand_ins(folder)
    with reading(folder / RESOLVED):
        scenario: dict[str, Any] = dict(table["scenario"])
        scenario["fleet"] = [
            {**one, "vehicle": instead.get(one["vehicle"], one["vehicle"])}
            for one in scenario["fleet"]
        ]
        config = table["benchmark"]
    return questions.again(folder, {"benchmark": config, "scenario": scenario}, planners)


def about(benchmark: Benchmark, building: Path, *, complete: bool) -> None:
    """Say what stands in the folder, for those who draw it."""
    config = benchmark.config
    made = read_table(building / ENVIRONMENT)
    table = {
        "name": config.name,
        "description": config.description,
        "deadline_s": config.deadline_s,
        "close_after": config.close_after,
        "problems": config.problems,
        "command": made.pop("command", ""),
        "versions": made.pop("versions", {}),
        "host": made,
        "planners": [
            {
                "label": one.label,
                "name": one.name,
                "settings": one.settings,
                "online": dict(one.online),
            }
            for one in benchmark.contestants
        ],
        "scenes": list(dict.fromkeys(setting.scene for setting in benchmark.settings)),
        "teams": sorted({setting.robots for setting in benchmark.settings}),
        "complete": complete,
    }
    atomic.write_text(building / ABOUT, json.dumps(table, indent=2) + "\n")
