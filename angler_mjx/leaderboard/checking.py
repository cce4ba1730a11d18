"""Checking of a submission: its plans are flown in truth, and the referee judges every flight.

The results folder holds ``result.json``, ``card.toml``, and the run folder of each set that had a
plan, without its trajectories unless they are to be kept.
"""

import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from angler_mjx import __version__
from angler_mjx.errors import ConfigError, format_value
from angler_mjx.leaderboard import problem_files, problem_sets, sandbox, submission, submitted_plans
from angler_mjx.leaderboard.check_results import RESULT, ProblemScore, is_complete
from angler_mjx.leaderboard.problem_files import ProblemManifest
from angler_mjx.leaderboard.problem_sets import FrozenBenchmark, ProblemSet
from angler_mjx.leaderboard.program_images import ProgramImage, open_image
from angler_mjx.leaderboard.set_scenarios import build_flown_scenario
from angler_mjx.leaderboard.submission import Card, ProgramConfig
from angler_mjx.leaderboard.submitted_plans import PlanRows
from angler_mjx.progress import Progress
from angler_mjx.runs import multi_run
from angler_mjx.runs.processes import OneProcess
from angler_mjx.runs.provenance import describe_environment, processor_name
from angler_mjx.runs.resumable_folder import open_folder
from angler_mjx.runs.storage import checksums, folder
from angler_mjx.runs.storage.atomic_files import write_json
from angler_mjx.runs.storage.parallel import cpu_count, map_in_order, open_processes
from angler_mjx.runs.storage.read_errors import read_table
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.studies.speed.measured import graph_search
from angler_mjx.testing import referee

ANSWERS, PROBLEMS = "answers", "problems"
MACHINE = "machine.json"
"""File of the judge's factor, in `ANSWERS`."""
NO_PATH = "no path"
"""What is said of a robot without a path whose file says nothing more."""
ROBOTS_PER_PROCESS = 32
"""Judged flights that are worth a further process: it takes some seconds to start."""


@dataclass(frozen=True, kw_only=True)
class CheckedSet:
    """A set of a submission on its way to its scores."""

    entry: ProblemSet
    scenario: Scenario
    rows: PlanRows | None
    """Plans; None where a planner or policy of the package flies."""
    bound_s: tuple[float, ...]
    """Of each problem; see `ProblemScore`."""
    time_factor: float = 1.0
    """Times as long as the reference core that the planning machine's core needs."""

    @property
    def run(self) -> str:
        """Place of its run in the results folder."""
        return f"{multi_run.RUNS_FOLDER}/{self.entry.name}"

    @property
    def flies(self) -> bool:
        """Whether there is anything to fly."""
        return self.rows is None or bool(np.any(self._planned() > 0))

    def _planned(self) -> np.ndarray:
        assert self.rows is not None
        is_fault = np.array([bool(fault) for fault in self.rows.faults])
        counts: np.ndarray = np.where(is_fault[:, None], 0, self.rows.arrays["points"])
        return counts


def check_submission(
    source: Path,
    out: Path,
    progress: Progress,
    *,
    manifest: ProblemManifest,
    secret: bytes = problem_sets.PUBLIC,
    sets: tuple[str, ...] = (),
    resume: bool = False,
    keep_flights: bool = False,
    processes: int = 1,
) -> bool:
    """Judge a submission into a results folder; whether all of it was judged.

    Args:
        source: folder of the submission.
        out: results folder to make.
        progress: receives the progress.
        manifest: of the problems.
        secret: that their seeds were made with; empty for the public problems.
        sets: sets or parts of their names that are judged; all entered ones if left out.
        resume: go on with an interrupted check.
        keep_flights: keep the trajectories, for replays.
        processes: processes that compile and fly side by side.

    Raises:
        ConfigError: the card cannot be understood, or the folder is taken.
        UnsupportedError: the sandbox for programs is not installed.
        RunError: the disk gave out.
    """
    benchmark, card = problem_sets.load_benchmark(), submission.read_card(source)
    entered = submission.select_entered(benchmark, card, source)
    chosen = {entry.name for entry in problem_sets.select_problem_sets(benchmark, sets)}
    entries = [entry for entry in entered if entry.name in chosen]
    if not entries:
        raise ConfigError(f"--sets {' '.join(sets)}: {source} enters none of them")
    if special := submission.find_special_file(source, links=True):
        raise ConfigError(f"{special}: is a pipe or device; a submission holds files and folders")
    if card.program is not None:
        _require_program(source, card.program)
        sandbox.require_sandbox()
    request = {
        "submission": checksums.hash_folder(source),
        "problems": manifest.sha256(),
        "sets": [entry.name for entry in entries],
    }
    declared = multi_run.declare_folder(
        "check of a submission", request, models={}, is_complete=is_complete
    )
    with open_folder(declared, out, resume=resume, processes=OneProcess()) as opened:
        building = opened.building
        shutil.copyfile(source / submission.CARD, building / submission.CARD)
        (building / ANSWERS).mkdir(exist_ok=True)
        time_factor = _find_time_factor(card, building / ANSWERS / MACHINE, progress)
        is_planned = all(_rows_file(building, entry).exists() for entry in entries)
        with open_image(source, None if is_planned else card.program, progress) as image:
            checked = _collect_plans(
                benchmark,
                card,
                source,
                building,
                entries,
                manifest,
                secret,
                progress,
                time_factor,
                image,
            )
        if not _fly_sets([one for one in checked if one.flies], building, progress, processes):
            return False
        scores = _judge_sets(checked, building, progress)
        opened.publish(
            partial(
                _write_result,
                card,
                manifest,
                entries,
                scores,
                time_factor,
                keep_flights=keep_flights,
            )
        )
    return True


def _require_program(source: Path, config: ProgramConfig) -> None:
    """Refuse submissions without the program's folder, or with links in place of it or its image.

    Raises:
        ConfigError: one of them.
    """
    program = source / sandbox.FOLDER
    is_needed = config.image is None or program.exists()
    if program.is_symlink() or (is_needed and not program.is_dir()):
        raise ConfigError(f"{program}: must be a folder, with the program of the card")
    if config.image is not None and (source / config.image).is_symlink():
        raise ConfigError(
            f"{source / submission.CARD}: program.image = {format_value(config.image)}: is a link; "
            "submit the file itself"
        )


def _find_time_factor(card: Card, path: Path, progress: Progress) -> float:
    """Return the factor of the planning times; the judge's is measured once, into a file."""
    if card.kind != "program":
        return card.machine_factor if card.kind == "plans" else 1.0
    if not path.exists():
        progress.describe("measuring this machine")
        write_json(path, {"factor": graph_search.measure_time_factor()})
    return float(read_table(path)["factor"])


def _fly_sets(
    checked: Sequence[CheckedSet], building: Path, progress: Progress, processes: int
) -> bool:
    """Fly what is left of the sets; whether all are flown then."""
    # Sets that differ in information fly the same programs, which the later ones then load.
    flown = sorted(checked, key=lambda one: one.entry.information)
    plans = {one.run: _answer_file(building, one.entry) for one in flown if one.rows}
    if processes < 2:
        parts = [(one.run, one.scenario) for one in flown]
        return multi_run.fly_runs(parts, building, progress, OneProcess(), {}, plans)
    groups: dict[object, list[CheckedSet]] = {}
    for one in sorted(flown, key=lambda one: -one.entry.robots):
        kind = (one.entry.robots, one.entry.condition, one.scenario.time.horizon_s)
        groups.setdefault(kind, []).append(one)
    return multi_run.fly_groups(
        [
            multi_run.RunGroup(
                building=building,
                parts=tuple((one.run, one.scenario) for one in group),
                plans={one.run: plans[one.run] for one in group if one.run in plans},
            )
            for group in groups.values()
        ],
        progress,
        processes,
    )


def _answer_file(building: Path, entry: ProblemSet) -> Path:
    return building / ANSWERS / f"{entry.name}.zarr"


def _rows_file(building: Path, entry: ProblemSet) -> Path:
    return building / ANSWERS / f"{entry.name}.npz"


def _collect_plans(
    benchmark: FrozenBenchmark,
    card: Card,
    source: Path,
    building: Path,
    entries: Sequence[ProblemSet],
    manifest: ProblemManifest,
    secret: bytes,
    progress: Progress,
    time_factor: float,
    image: ProgramImage,
) -> list[CheckedSet]:
    """Read, or make in the sandbox, the plans of all sets, and write them as they will be flown."""
    if card.program is not None:
        problem_files.write_problem_files(
            benchmark, entries, building / PROBLEMS, progress, secret=secret, frozen=manifest
        )
    checked = []
    for number, entry in enumerate(entries):
        record = manifest.find(entry.name)
        scenario = problem_files.build_set_scenario(benchmark, entry, record.attempt, secret)
        if scenario.digest() != record.digest:
            raise ConfigError(
                f"{entry.name}: this version makes other worlds (digest {scenario.digest()[:12]}) "
                f"than those of the manifest ({record.digest[:12]})"
            )
        progress.describe(f"plans of {entry.name} ({number + 1} of {len(entries)})")
        if card.in_flight is not None:
            flown = build_flown_scenario(scenario, card.in_flight, submission.CARD)
            checked.append(
                CheckedSet(entry=entry, scenario=flown, rows=None, bound_s=record.bound_s)
            )
            continue
        if card.program is not None:
            # An interrupted check goes on with the plans, times and faults that it has.
            stored = _rows_file(building, entry)
            if not stored.exists() and image.fault:
                submitted_plans.store_rows(stored, submitted_plans.empty_rows(entry, image.fault))
            elif not stored.exists():
                rows = sandbox.plan_set(
                    source,
                    card.program,
                    entry,
                    scenario,
                    record,
                    building / PROBLEMS,
                    time_factor,
                    image.root,
                )
                submitted_plans.store_rows(stored, rows)
            rows = submitted_plans.load_rows(stored)
        else:
            path = source / submission.PLANS / f"{entry.name}.zarr"
            seed = problem_files.printed_seed(scenario, secret)
            rows = submitted_plans.read_plans(path, entry, record, seed, scenario.planner.points)
        one = CheckedSet(
            entry=entry,
            scenario=scenario,
            rows=rows,
            bound_s=record.bound_s,
            time_factor=time_factor,
        )
        # An interrupted check flies the plans that its flight was begun with.
        if one.flies and multi_run.run_status(building / one.run) == "none":
            submitted_plans.write_plans(_answer_file(building, entry), scenario, rows)
        checked.append(one)
    return checked


def _judge_sets(
    checked: Sequence[CheckedSet], building: Path, progress: Progress
) -> list[ProblemScore]:
    """Have the referee recompute all flights, in processes side by side, and score them."""
    scores: list[ProblemScore] = []
    flown = [one for one in checked if one.flies]
    robots = sum(one.entry.problems * one.entry.robots for one in flown)
    worlds = [(building / one.run, world) for one in flown for world in range(one.entry.problems)]
    progress.start(sum(one.entry.problems for one in checked), unit="problems judged")
    with open_processes(min(cpu_count(), robots // ROBOTS_PER_PROCESS), __name__) as pool:
        faults = map_in_order(_judge_world, worlds, pool)
        for one in checked:
            progress.describe(f"judging {one.entry.name}")
            if one.flies:
                scores += _judge_flown(one, building / one.run, faults, progress)
            else:
                scores += [_unflown_score(one, world) for world in range(one.entry.problems)]
                progress.advance(one.entry.problems)
    return scores


def _judge_flown(
    one: CheckedSet, path: Path, faults: Iterator[str], progress: Progress
) -> list[ProblemScore]:
    """Score the worlds of a set; the next verdicts of the referee are those on them."""
    by_world: dict[int, list[dict[str, Any]]] = {}
    for row in folder.Run(path).episodes.to_pylist():
        by_world.setdefault(row["world"], []).append(row)
    scores = []
    for world in range(one.entry.problems):
        scores.append(_flown_score(one, world, by_world[world], next(faults)))
        progress.advance(1)
    return scores


def _judge_world(judged: tuple[Path, int]) -> str:
    """Return why the referee does not confirm the flights of a world; empty if it does."""
    path, world = judged
    verdict = referee.judge(path, [world])
    for finding in verdict.differences:
        if finding.result == "disagrees":
            return f"the referee disagrees: {finding.line()}"
    outcomes = verdict.counts["outcome"]
    if outcomes.exact < verdict.robots:
        return f"the referee could not compute all outcomes again: {'; '.join(outcomes.why)}"
    return ""


def _flown_score(
    one: CheckedSet, world: int, episodes: Sequence[Mapping[str, Any]], fault: str
) -> ProblemScore:
    arrived = [row for row in episodes if row["outcome"] == "reached"]
    reason = fault or _find_fault(one, world) or _find_late(one, world)
    if reason:  # plans that do not count bring nobody there
        arrived = []
    missing = [row for row in episodes if row["plan_reason"]]
    if not reason and missing:
        robot, text = missing[0]["robot"], missing[0]["plan_reason"]
        text = _find_note(one, world, robot) if text == NO_PATH else text
        reason = f"robot {robot} has no plan: {text}"
    if not reason and len(arrived) < len(episodes):
        first = next(row for row in episodes if row["outcome"] != "reached")
        reason = f"robot {first['robot']}: {first['outcome']}"
    clearances = [
        value
        for row in episodes
        for value in (row["min_clearance_m"], row["min_separation_m"])
        if value is not None
    ]
    solved = not reason
    return ProblemScore(
        problem=f"{one.entry.name}/{world}",
        set=one.entry.name,
        robots=len(episodes),
        solved=solved,
        planned=sum(bool(row["planned"]) or one.rows is None for row in episodes),
        arrived=len(arrived),
        makespan_s=max(row["time_to_goal_s"] for row in arrived) if solved else None,
        bound_s=one.bound_s[world],
        energy_j=sum(row["energy_j"] for row in episodes),
        clearance_m=min(clearances),
        planning_s=_planning_s(one, world, episodes),
        time_factor=one.time_factor,
        reason=reason,
    )


def _unflown_score(one: CheckedSet, world: int) -> ProblemScore:
    return ProblemScore(
        problem=f"{one.entry.name}/{world}",
        set=one.entry.name,
        robots=one.entry.robots,
        solved=False,
        planned=0,
        arrived=0,
        makespan_s=None,
        bound_s=one.bound_s[world],
        energy_j=0.0,
        clearance_m=None,
        planning_s=_planning_s(one, world, ()),
        time_factor=one.time_factor,
        reason=_find_fault(one, world) or f"robot 0 has no plan: {_find_note(one, world, 0)}",
    )


def _planning_s(one: CheckedSet, world: int, episodes: Sequence[Mapping[str, Any]]) -> float | None:
    if one.rows is None:
        return episodes[0]["planning_s"] if episodes else None
    seconds = float(one.rows.planning_s[world]) / one.time_factor
    return seconds if np.isfinite(seconds) else None


def _find_fault(one: CheckedSet, world: int) -> str:
    return one.rows.faults[world] if one.rows is not None else ""


def _find_note(one: CheckedSet, world: int, robot: int) -> str:
    """Return why a robot has no path, by its file of plans."""
    note = "" if one.rows is None else one.rows.notes.get((world, robot), "")
    return note or NO_PATH


def _find_late(one: CheckedSet, world: int) -> str:
    if one.rows is None:
        return ""
    seconds = _planning_s(one, world, ())
    if seconds is None:
        return "states no planning time (planning_s)"
    if seconds <= one.entry.limit_s:
        return ""
    scaled = "" if one.time_factor == 1.0 else f" (divided by the factor {one.time_factor:.2f})"
    return f"planned for {seconds:.4g} s{scaled}, at most {one.entry.limit_s:g} s"


def _write_result(
    card: Card,
    manifest: ProblemManifest,
    entries: Sequence[ProblemSet],
    scores: Sequence[ProblemScore],
    time_factor: float,
    building: Path,
    *,
    keep_flights: bool,
) -> None:
    """Write the result, and remove what nobody needs any more."""
    environment = describe_environment()
    write_json(
        building / RESULT,
        {
            "benchmark": manifest.benchmark,
            "problems_sha256": manifest.sha256(),
            "hidden": manifest.secret != problem_sets.digest_secret(problem_sets.PUBLIC),
            "card": card.model_dump(mode="json", exclude_none=True),
            "entered": [entry.name for entry in entries],
            "physics": {"angler-mjx": __version__, "commit": environment.get("commit")},
            "judged_on": environment["device"],
            "planned_on": {
                "machine": _name_machine(card, str(environment["device"])),
                "factor": time_factor,
            },
            "scores": [score.model_dump() for score in scores],
        },
    )
    (building / multi_run.REQUEST_FILE).unlink()
    for name in (ANSWERS, PROBLEMS):
        shutil.rmtree(building / name, ignore_errors=True)
    if not keep_flights:
        for path in (building / multi_run.RUNS_FOLDER).glob(f"*/{folder.TRAJECTORIES}"):
            shutil.rmtree(path)


def _name_machine(card: Card, device: str) -> str:
    """Return the machine of the planning times: the judge's, unless the card brings plans."""
    if card.kind == "plans":
        return card.machine
    return processor_name() if card.kind == "program" or device == "cpu" else device
