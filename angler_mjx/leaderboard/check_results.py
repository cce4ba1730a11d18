"""Results of checks: ``result.json``, read without trust in it."""

from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import Field, model_validator

from angler_mjx.errors import ConfigError, format_value
from angler_mjx.files import FileModel, parse_model
from angler_mjx.leaderboard import problem_files, problem_sets
from angler_mjx.leaderboard.submission import Card
from angler_mjx.runs.storage.read_errors import read_table

RESULT = "result.json"


class ProblemScore(FileModel):
    """Score of one problem."""

    problem: str
    set: str
    robots: int
    solved: bool
    """Whether every robot arrived, in time, and the referee agrees."""
    planned: int
    """Robots with a path; all of them where none is needed."""
    arrived: int
    makespan_s: float | None
    """Arrival of the last robot; null unless solved."""
    bound_s: Annotated[float, Field(gt=0)]
    """Time of the longest straight line from start to goal at cruise speed: no makespan is less
    in still water."""
    energy_j: float
    """Energy of all robots until their ends."""
    clearance_m: float | None
    """Least distance of any robot to rock, floor, obstacles and other robots; null unless flown."""
    planning_s: float | None
    """Planning time, over the factor of its machine; null if it is not known."""
    time_factor: Annotated[float, Field(gt=0)]
    """Factor that the planning time was divided by."""
    reason: str
    """Why it is not solved; empty if it is."""

    @model_validator(mode="after")
    def _require_consistent(self) -> Self:
        is_arrival = self.makespan_s is not None and self.arrived == self.robots
        if self.solved != (self.reason == "") or (self.solved and not is_arrival):
            raise ValueError(
                "a solved problem has no reason, a makespan_s, and all robots arrived; "
                "another has a reason"
            )
        return self


class Physics(FileModel):
    """Version of the package that flew."""

    angler_mjx: Annotated[str, Field(alias="angler-mjx")]
    commit: str | None = None


class PlanningMachine(FileModel):
    """Machine of the planning times."""

    machine: str
    factor: float
    """Greatest factor that a planning time was divided by."""


class CheckResult(FileModel):
    """What `RESULT` holds."""

    benchmark: str
    problems_sha256: str
    hidden: bool
    card: Card
    entered: Annotated[tuple[str, ...], Field(min_length=1)]
    physics: Physics
    judged_on: str
    planned_on: PlanningMachine
    scores: Annotated[tuple[ProblemScore, ...], Field(min_length=1)]

    @model_validator(mode="after")
    def _require_problems(self) -> Self:
        """Refuse scores that are of none of the entered sets' problems, or twice of one."""
        sets = {
            entry.name: entry
            for entry in problem_sets.list_problem_sets(problem_sets.load_benchmark())
        }
        if unknown := [name for name in self.entered if name not in sets]:
            raise ValueError(f"entered: there is no problem set {format_value(unknown[0])}")
        robots = {
            problem: entry.robots
            for name in self.entered
            for entry in [sets[name]]
            for problem in entry.problem_names()
        }
        seen: set[str] = set()
        for score in self.scores:
            stated = (score.problem.rpartition("/")[0], score.robots)
            if stated != (score.set, robots.get(score.problem)) or score.problem in seen:
                raise ValueError(
                    f"scores: {format_value(score.problem)} is no problem of the entered sets, is "
                    "there twice, or has another set or number of robots"
                )
            seen.add(score.problem)
        public = problem_files.public_manifest().sha256()
        if self.hidden == (self.problems_sha256 == public):
            raise ValueError(
                f"hidden = {format_value(self.hidden)}, but problems_sha256 is "
                f"{'that' if self.hidden else 'not that'} of the public problems"
            )
        return self


def is_complete(out: Path) -> bool:
    """Return whether a folder holds the result of a check."""
    return (out / RESULT).is_file()


def read_result(out: Path) -> dict[str, Any]:
    """Read the result of a check.

    Raises:
        ConfigError: there is none, it is damaged, or it is of another version of the benchmark.
    """
    path = out / RESULT if out.is_dir() else out
    if not path.is_file():
        raise ConfigError(f"{out}: holds no {RESULT}; angler leaderboard check makes one")
    table = read_table(path)
    title = problem_sets.load_benchmark().title
    if table.get("benchmark") != title:
        raise ConfigError(f"{path}: is of {table.get('benchmark')!r}, this program has {title!r}")
    parse_model(CheckResult, table, source=str(path))
    return table
