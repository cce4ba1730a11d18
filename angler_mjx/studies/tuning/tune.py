"""Tuning from settings to a folder: search, measure, write."""

from importlib.metadata import version
from pathlib import Path
from typing import Any, Protocol

from angler_mjx.errors import ConfigError
from angler_mjx.robot.vehicles.thrusters import FloatArray
from angler_mjx.runs import provenance
from angler_mjx.runs.storage.damage import reading
from angler_mjx.runs.storage.output_lock import OutputLock
from angler_mjx.studies.tuning import folder, outcome, report, search
from angler_mjx.studies.tuning.optimisers import Adam, Cma, Optimiser
from angler_mjx.studies.tuning.outcome import TuningOutcome
from angler_mjx.studies.tuning.problem import TuningProblem, TuningSettings
from angler_mjx.studies.tuning.search import Generation, TuningHistory


class TuningProgress(Protocol):
    """What a tuning tells while it goes on."""

    def start(self, flights: int, done: int) -> None:
        """A search of so many flights begins, some of them flown before."""

    def flown(self, flights: int) -> None:
        """A device call is over."""

    def generation(self, number: int, best: float) -> None:
        """A generation is over; the least cost so far."""

    def measuring(self) -> None:
        """The search is over; what it found is flown again."""


class SilentTuningProgress:
    """A progress that says nothing."""

    def start(self, flights: int, done: int) -> None:
        """See `TuningProgress`."""

    def flown(self, flights: int) -> None:
        """See `TuningProgress`."""

    def generation(self, number: int, best: float) -> None:
        """See `TuningProgress`."""

    def measuring(self) -> None:
        """See `TuningProgress`."""


def tune(
    settings: TuningSettings,
    out: Path,
    progress: TuningProgress | None = None,
    *,
    resume: bool = False,
) -> TuningOutcome:
    """Tune into a new folder.

    An interrupt ends the search after the last whole generation; what was found by then is
    measured and written as it would have been at the end, and the folder can be taken up again.

    Args:
        settings: of the tuning.
        out: folder to make.
        progress: told how it goes.
        resume: go on with an interrupted tuning of the same settings.

    Raises:
        ConfigError: settings that cannot be used, or a folder that is taken.
        UnsupportedError: the package of the method is not installed.
        RunError: the disk gave out.
        KeyboardInterrupt: before anything was found.
    """
    told = progress or SilentTuningProgress()
    problem = TuningProblem(settings)
    optimiser = _optimiser(problem)
    claimed, table, history = _open(settings, out, optimiser, resume=resume)
    try:
        return _tune(problem, optimiser, claimed, table, history, told)
    finally:
        claimed.release()


def _tune(
    problem: TuningProblem,
    optimiser: Optimiser,
    claimed: OutputLock,
    table: dict[str, Any],
    history: TuningHistory,
    told: TuningProgress,
) -> TuningOutcome:
    """Search on in a folder, and close it."""
    settings, building = problem.settings, claimed.building
    each = optimiser.population * settings.rollouts
    told.start(settings.generations * each, len(history.generations) * each)

    def evaluate(candidates: FloatArray, *, gradients: bool) -> Generation:
        return problem.evaluate(candidates, gradients=gradients, done=told.flown)

    def keep(known: TuningHistory) -> None:
        folder.save(building, table, known, complete=False)
        told.generation(len(known.generations), known.best()[0])

    try:
        search.run(optimiser, evaluate, history, settings.generations, keep)
    except KeyboardInterrupt:
        if not history.generations:
            raise
    told.measuring()
    found = outcome.measure(problem, history, table["provenance"])
    report.write(building, found)
    folder.save(building, table, history, complete=found.complete)
    claimed.publish()
    return found


def _optimiser(problem: TuningProblem) -> Optimiser:
    low, high = ([getattr(knob, end) for knob in problem.knobs] for end in ("low", "high"))
    settings = problem.settings
    if settings.method == "gradient":
        return Adam(low, high, settings.generations)
    return Cma(low, high, settings.seed)


def _open(
    settings: TuningSettings, out: Path, optimiser: Optimiser, *, resume: bool
) -> tuple[OutputLock, dict[str, Any], TuningHistory]:
    """The claimed folder, what its checkpoint begins with, and what was found before."""
    if not resume:
        claimed, history = folder.create(out), TuningHistory()
        table = {"settings": settings.table(), "provenance": _provenance(settings)}
        try:
            folder.save(claimed.building, table, history, complete=False)
        except BaseException:
            claimed.withdraw()
            raise
        return claimed, table, history
    wanted = settings.table()
    claimed, known = folder.reopen(out, lambda known: _require_same(known["settings"], wanted, out))
    try:
        with reading(claimed.building / folder.CHECKPOINT, folder.ADVICE):
            table = {name: known[name] for name in ("settings", "provenance")}
            return claimed, table, search.replayed(optimiser, folder.generations(known))
    except BaseException:
        claimed.release()
        raise


def _require_same(stored: dict[str, Any], wanted: dict[str, Any], out: Path) -> None:
    """Refuse to go on with a tuning of other settings."""
    for name in sorted({*wanted, *stored}):
        value = stored.get(name)
        if name not in wanted or wanted[name] != value:
            shown = "" if name == "scenario" else f" ({value} there, {wanted.get(name)} here)"
            raise ConfigError(
                f"--resume {out}: that tuning has another {name}{shown}; give the same again"
            )


def _provenance(settings: TuningSettings) -> dict[str, Any]:
    """Of this process, with the package that searches."""
    origin = provenance.describe_environment()
    if settings.method == "cma":
        origin["versions"]["cmaes"] = version("cmaes")
    return origin
