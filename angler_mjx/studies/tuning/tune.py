"""Tuning from settings to a folder: search, measure, write."""

from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

from angler_mjx.errors import ConfigError
from angler_mjx.files import rename_keys
from angler_mjx.progress import Progress
from angler_mjx.robot.vehicles.thrusters import FloatArray
from angler_mjx.runs import provenance
from angler_mjx.runs.processes import OneProcess
from angler_mjx.runs.resumable_folder import OpenFolder, open_folder
from angler_mjx.runs.storage.read_errors import wrap_read_errors
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.studies.tuning import folder, outcome, report, search
from angler_mjx.studies.tuning.folder import TuningCheckpoint
from angler_mjx.studies.tuning.optimisers import Adam, Cma, Optimiser
from angler_mjx.studies.tuning.outcome import TuningOutcome
from angler_mjx.studies.tuning.problem import TuningProblem, TuningSettings
from angler_mjx.studies.tuning.search import Generation, TuningHistory


def tune(
    settings: TuningSettings,
    out: Path,
    progress: Progress | None = None,
    *,
    resume: bool = False,
) -> TuningOutcome:
    """Tune into a new folder.

    An interrupt ends the search after the last whole generation; what was found by then is
    measured and written as it would have been at the end, and the folder can be taken up again.

    Args:
        settings: of the tuning.
        out: folder to make.
        progress: receives the progress.
        resume: go on with an interrupted tuning of the same settings.

    Raises:
        ConfigError: settings that cannot be used, or a folder that is taken.
        UnsupportedError: the package of the method is not installed.
        RunError: the disk gave out.
        KeyboardInterrupt: before anything was found.
    """
    problem = TuningProblem(settings)
    optimiser = _build_optimiser(problem)
    wanted = settings.table()
    declared = folder.declare_folder(
        TuningCheckpoint(settings=wanted, provenance=_describe_provenance(settings)),
        lambda checkpoint: _require_same(checkpoint.settings, wanted, out),
    )
    with open_folder(declared, out, resume=resume, processes=OneProcess()) as opened:
        with wrap_read_errors(opened.building / folder.CHECKPOINT, folder.ADVICE):
            history = search.replay_history(optimiser, opened.start.generations)
        return _search_and_write(problem, optimiser, opened, history, progress or Progress())


def _search_and_write(
    problem: TuningProblem,
    optimiser: Optimiser,
    opened: OpenFolder[TuningCheckpoint],
    history: TuningHistory,
    progress: Progress,
) -> TuningOutcome:
    """Search on in a folder, and publish it."""
    settings = problem.settings
    each = optimiser.population * settings.rollouts
    progress.start(settings.generations * each, len(history.generations) * each, "flights")
    progress.describe("compiling")

    def evaluate(candidates: FloatArray, *, gradients: bool) -> Generation:
        return problem.evaluate(candidates, gradients=gradients, done=progress.advance)

    def save(building: Path, *, complete: bool) -> None:
        checkpoint = replace(opened.start, complete=complete, generations=history.generations)
        folder.save_checkpoint(building, checkpoint)

    def keep(current: TuningHistory) -> None:
        save(opened.building, complete=False)
        progress.describe(f"generation {len(current.generations)}, best {current.best()[0]:.4f}")

    try:
        search.run_search(optimiser, evaluate, history, settings.generations, keep)
    except KeyboardInterrupt:
        if not history.generations:
            raise
    progress.describe("measuring what was found")
    tuning_outcome = outcome.measure_outcome(problem, history, opened.start.provenance)

    def write(building: Path) -> None:
        report.write_report(building, tuning_outcome)
        save(building, complete=tuning_outcome.complete)

    opened.publish(write)
    return tuning_outcome


def _build_optimiser(problem: TuningProblem) -> Optimiser:
    low, high = ([getattr(knob, end) for knob in problem.knobs] for end in ("low", "high"))
    settings = problem.settings
    if settings.method == "gradient":
        return Adam(low, high, settings.generations)
    return Cma(low, high, settings.seed)


def _require_same(stored: dict[str, object], wanted: dict[str, object], out: Path) -> None:
    """Refuse to resume a tuning of other settings.

    Keys of its scenario may have been renamed since it was begun.
    """
    if isinstance(scenario := stored.get("scenario"), dict):
        stored = {**stored, "scenario": rename_keys(Scenario, scenario, folder.CHECKPOINT)}
    for name in sorted({*wanted, *stored}):
        value = stored.get(name)
        if name not in wanted or wanted[name] != value:
            shown = "" if name == "scenario" else f" ({value} there, {wanted.get(name)} here)"
            raise ConfigError(
                f"--resume {out}: that tuning has another {name}{shown}; give the same again"
            )


def _describe_provenance(settings: TuningSettings) -> dict[str, Any]:
    """Of this process, with the package that searches."""
    origin = provenance.describe_environment()
    if settings.method == "cma":
        origin["versions"]["cmaes"] = version("cmaes")
    return origin
