"""Baselines: the package's planners and policies, planned, flown, judged and stored part by part.

A part is a baseline's sets with teams of one size, or all of them where several processes make
them. The folder of the work holds ``BASELINE/PART/submission`` and ``BASELINE/PART/check``;
whatever is there is kept, so that an interrupted call is continued by the same call: plans set by
set, flights run by run. A baseline's judged parts are merged into one result, which `board` shows.
"""

import json
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from angler_mjx.errors import ConfigError, format_value
from angler_mjx.leaderboard import (
    check_results,
    checking,
    entering,
    problem_files,
    problem_sets,
    set_scenarios,
    submission,
)
from angler_mjx.leaderboard.problem_files import ProblemManifest
from angler_mjx.leaderboard.problem_sets import FrozenBenchmark, ProblemSet
from angler_mjx.progress import Progress
from angler_mjx.runs.storage import output_lock
from angler_mjx.runs.storage.atomic_files import write_json, write_text

HOST_PLANNERS = (
    "RRTConnect",
    "BKPIECE1",
    "KPIECE1",
    "LBKPIECE1",
    "RRT",
    "PRM",
    "RRTstar",
    "PRMstar",
    "InformedRRTstar",
    "SORRTstar",
    "BITstar",
    "FMT",
    "BFMT",
    "AORRTC",
)
"""Planners of OMPL."""
ALL = "all"
"""Folder of a part with teams of all sizes."""
MAX_HOST_ROBOTS = 8
"""Robots of the largest teams that they enter for: they search the space of all robots at once."""


@dataclass(frozen=True, kw_only=True)
class Baseline:
    """A planner or policy of the package that enters the benchmark."""

    name: str
    """On the board, and of its folder."""
    settings: Mapping[str, object] = field(default_factory=dict)
    """Settings of the planner, the scenario's table ``[planner.NAME]``."""
    in_flight: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    """The card's table ``[in_flight]``; empty for plans."""
    max_robots: int | None = None
    """Robots of the largest team that it enters for; None: any."""


BASELINES = (
    Baseline(name="priority"),
    Baseline(name="grid"),
    Baseline(name="current", settings={"limit_ground_speed": True}),
    Baseline(name="mppi", in_flight={"policy": {"name": "mppi"}}),
    *(Baseline(name=name, max_robots=MAX_HOST_ROBOTS) for name in HOST_PLANNERS),
)
"""All, in the order in which they are made."""


def planner_table(name: str) -> dict[str, object]:
    """Return the scenario's table ``[planner]`` of a planner, with the settings of its baseline."""
    settings = {baseline.name: dict(baseline.settings) for baseline in BASELINES}.get(name)
    return {"name": name, name: settings} if settings else {"name": name}


def select_baselines(names: Sequence[str]) -> list[Baseline]:
    """Return baselines by their names; all if there is none.

    Raises:
        ConfigError: there is no such baseline.
    """
    by_name = {baseline.name: baseline for baseline in BASELINES}
    if unknown := [name for name in names if name not in by_name]:
        raise ConfigError(
            f"--only {format_value(unknown[0])}: no such baseline; there is {', '.join(by_name)}"
        )
    return [by_name[name] for name in names] if names else list(BASELINES)


def make_baselines(
    baselines: Sequence[Baseline],
    out: Path,
    store: Path,
    progress: Progress,
    *,
    sets: tuple[str, ...] = (),
    workers: int | None = None,
    processes: int = 1,
    keep_flights: bool = False,
) -> Iterator[Path]:
    """Plan, check and store baselines; parts that are judged are kept.

    Args:
        baselines: what to make.
        out: folder of the work, new or of an earlier call.
        store: folder of the results, ``BASELINE.json``.
        progress: receives the progress.
        sets: sets or parts of their names; all that each can plan if left out.
        workers: planning processes, for planners of the host.
        processes: processes that compile, plan and fly side by side on the device.
        keep_flights: keep the trajectories, for films.

    Yields:
        Each stored result, once with every part that was made.

    Raises:
        ConfigError: a folder holds something else.
        KeyboardInterrupt: a check was interrupted.
        RunError: the disk gave out.
    """
    benchmark, manifest = problem_sets.load_benchmark(), problem_files.public_manifest()
    for baseline in baselines:
        chosen = problem_sets.select_problem_sets(benchmark, sets)
        refusals = {
            entry.name: reason
            for entry in chosen
            if (reason := _find_refusal(baseline, benchmark, entry, manifest))
        }
        entries = [entry for entry in chosen if entry.name not in refusals]
        if refusals:
            first = next(iter(refusals.values()))
            progress.report(
                f"{baseline.name} does not enter {len(refusals)} of {len(chosen)} sets: {first}"
            )
        parts: dict[str, list[ProblemSet]] = {}
        for entry in entries:
            parts.setdefault(f"{entry.robots:02d}" if processes < 2 else ALL, []).append(entry)
        for number, (name, part) in enumerate(parts.items()):
            team = "teams of all sizes" if name == ALL else f"teams of {int(name)}"
            progress.report(f"{baseline.name}, part {number + 1} of {len(parts)}: {team}")
            folder = out / baseline.name / name
            if not check_results.is_complete(folder / "check"):
                _make_part(
                    baseline,
                    part,
                    folder,
                    progress,
                    manifest,
                    workers=workers,
                    processes=processes,
                    keep_flights=keep_flights,
                )
            yield _store_result(baseline, out, store)


def _find_refusal(
    baseline: Baseline, benchmark: FrozenBenchmark, entry: ProblemSet, manifest: ProblemManifest
) -> str:
    """Return why a baseline does not enter a set; empty if it does. Policies take all."""
    if baseline.max_robots is not None and entry.robots > baseline.max_robots:
        return f"{entry.name}: it enters for teams of up to {baseline.max_robots} robots"
    if baseline.in_flight:
        return ""
    attempt = manifest.find(entry.name).attempt
    scenario = problem_files.build_set_scenario(benchmark, entry, attempt, problem_sets.PUBLIC)
    try:
        set_scenarios.build_planned_scenario(scenario, planner_table(baseline.name), "baselines")
    except ConfigError as error:
        return str(error)
    return ""


def _make_part(
    baseline: Baseline,
    part: Sequence[ProblemSet],
    folder: Path,
    progress: Progress,
    manifest: ProblemManifest,
    *,
    workers: int | None,
    processes: int,
    keep_flights: bool,
) -> None:
    names = tuple(entry.name for entry in part)
    source, check = folder / "submission", folder / "check"
    if baseline.in_flight:
        source.mkdir(parents=True, exist_ok=True)
        write_text(source / submission.CARD, _format_card(baseline, names))
    else:
        entering.plan_submission(
            source,
            planner_table(baseline.name),
            progress,
            manifest=manifest,
            name=baseline.name,
            sets=names,
            workers=workers,
            processes=processes,
        )
    is_begun = output_lock.partial_path(check).exists()
    if not checking.check_submission(
        source,
        check,
        progress,
        manifest=manifest,
        resume=is_begun,
        keep_flights=keep_flights,
        processes=processes,
    ):
        raise KeyboardInterrupt


def _format_card(baseline: Baseline, sets: Sequence[str]) -> str:
    benchmark = problem_sets.load_benchmark()
    lines = [
        "schema_version = 1",
        f"benchmark = {json.dumps(benchmark.title)}",
        f"name = {json.dumps(baseline.name)}",
        f"description = {json.dumps(f'{baseline.name} of this package, in flight')}",
        'kind = "in_flight"',
        f"sets = {json.dumps(list(sets))}",
        "",
        "[in_flight]",
    ]
    for part, table in baseline.in_flight.items():
        keys = ", ".join(f"{key} = {json.dumps(value)}" for key, value in table.items())
        lines.append(f"{part} = {{ {keys} }}")
    return "\n".join(lines) + "\n"


def _store_result(baseline: Baseline, out: Path, store: Path) -> Path:
    """Merge the judged parts of a baseline into one result."""
    paths = sorted((out / baseline.name).glob(f"*/check/{check_results.RESULT}"))
    path = store / f"{baseline.name}.json"
    store.mkdir(parents=True, exist_ok=True)
    parts = [check_results.read_result(part) for part in paths]
    write_json(path, merge_results(parts, baseline.name))
    return path


def merge_results(parts: Sequence[Mapping[str, Any]], name: str) -> dict[str, Any]:
    """Return one result of the results of parts of the sets; it names the machines of all parts.

    Args:
        parts: results of different sets, by one planner.
        name: of the planner, for messages.

    Raises:
        ConfigError: they are of other problems or of the same set, or were flown by different
            physics.
    """
    first = parts[0]
    for key in ("benchmark", "problems_sha256", "hidden", "physics"):
        if any(part[key] != first[key] for part in parts):
            raise ConfigError(
                f"{name}: its parts have different {key}; remove those of the older version"
            )
    counts = Counter(entered for part in parts for entered in part["entered"])
    if repeated := [entered for entered, count in counts.items() if count > 1]:
        raise ConfigError(
            f"{name}: {repeated[0]} was judged in two parts; make it in another folder (--out)"
        )
    planned = [part["planned_on"] for part in parts]
    factor = max(part["factor"] for part in planned)  # each problem's own stands in its score
    entered = [name for part in parts for name in part["entered"]]
    return {
        **first,
        "card": {
            **first["card"],
            "machine": _join_distinct(part["card"]["machine"] for part in parts),
            "machine_factor": factor,
            "sets": entered,
        },
        "entered": entered,
        "judged_on": _join_distinct(part["judged_on"] for part in parts),
        "planned_on": {
            "machine": _join_distinct(part["machine"] for part in planned),
            "factor": factor,
        },
        "scores": [score for part in parts for score in part["scores"]],
    }


def _join_distinct(names: Iterable[str]) -> str:
    """Return names that are not empty, each once, in their order."""
    return "; ".join(dict.fromkeys(name for name in names if name))
