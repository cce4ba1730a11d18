"""Submissions: folders with a card and plans or a program, read without trust in any of it.

    card.toml           who, what, on which machine, and which sets are entered
    plans/SET.zarr      a file of plans for each set; see `submitted_plans`
    program             a program that plans; see `sandbox`
    image.tar           files of a container for the program; see `program_images`

A card that cannot be understood is refused.
"""

import re
import stat
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, field_validator, model_validator

from angler_mjx.errors import ConfigError, format_value
from angler_mjx.files import FileModel, parse_model, read_toml
from angler_mjx.leaderboard import problem_sets
from angler_mjx.leaderboard.problem_sets import FrozenBenchmark, ProblemSet
from angler_mjx.user_classes import is_class_of_file

CARD, PLANS = "card.toml", "plans"
_PINNED = ("deadline_s", "points")
"""Keys of a scenario's ``planner`` that are the benchmark's."""
_IMAGE_NAME = re.compile(r"\w[\w.-]{0,199}", re.ASCII)
NO_POLICY = "none"
"""Policy of robots that fly their plans."""
MIN_REPLAN_HZ = 0.1
"""Least rate at which a planner that enters in flight plans anew: twelve times before the shortest
horizon, 120 s."""

type Text = Annotated[str, Field(min_length=1, max_length=2000)]
type Argument = Annotated[str, Field(max_length=2000, pattern=r"^[^\x00]*$")]
type VariableName = Annotated[str, Field(max_length=200, pattern=r"^[A-Za-z_][A-Za-z0-9_]*$")]


class ProgramConfig(FileModel):
    """A program that plans problem by problem, run in a sandbox."""

    command: Annotated[tuple[Argument, ...], Field(min_length=1, max_length=64)]
    """Program and arguments; relative to the submission's folder ``program``. It receives the paths
    of the problem and of the plan to write as two further arguments."""
    image: str | None = None
    """Name of a file in the submission's folder: the file system of a container as a tar file. The
    program sees it in place of the system's folders."""
    environment: dict[VariableName, Argument] = Field(default_factory=dict, max_length=64)
    """Environment variables."""
    memory_gib: Annotated[float, Field(gt=0, le=64)] = 4.0
    processes: Annotated[int, Field(ge=1, le=256)] = 16

    @field_validator("image")
    @classmethod
    def _require_name(cls, name: str | None) -> str | None:
        if name is not None and not _IMAGE_NAME.fullmatch(name):
            raise ValueError(
                "must be the name of a tar file in the submission's folder, such as 'image.tar', "
                "in letters, digits, '.', '_' and '-'"
            )
        return name


class InFlightConfig(FileModel):
    """A planner or policy of the package that commands the robots in flight."""

    planner: dict[str, Any] = Field(default_factory=dict)
    """Keys of a scenario's ``planner``."""
    policy: dict[str, Any] = Field(default_factory=dict)
    """Keys of a scenario's ``policy``."""
    execution: dict[str, Any] = Field(default_factory=dict)
    """Keys of a scenario's ``execution``."""

    @field_validator("planner")
    @classmethod
    def _refuse_pinned(cls, table: dict[str, Any]) -> dict[str, Any]:
        if pinned := [key for key in _PINNED if key in table]:
            raise ValueError(f"{pinned[0]} is given by the benchmark: leave it out")
        return table

    @model_validator(mode="after")
    def _require_flight(self) -> Self:
        """Refuse planners that only plan before the flight: their time has a limit."""
        rate = self.planner.get("replan_hz")
        is_replanned = isinstance(rate, int | float) and rate >= MIN_REPLAN_HZ
        if not self.has_policy and not is_replanned:
            raise ValueError(
                "commands nothing in flight: give a policy, or a planner with replan_hz of at "
                f"least {MIN_REPLAN_HZ:g}; plans made before the flight are entered as "
                'kind = "plans" (angler leaderboard plan)'
            )
        return self

    @property
    def has_policy(self) -> bool:
        """Return whether a policy commands the robots."""
        return self.policy.get("name", NO_POLICY) not in ("", NO_POLICY)

    @field_validator("planner", "policy")
    @classmethod
    def _refuse_code(cls, table: dict[str, Any]) -> dict[str, Any]:
        """Refuse classes of files: they would run in the judge's process, outside the sandbox."""
        name = str(table.get("name", ""))
        if is_class_of_file(name):
            raise ValueError(
                f"name = {format_value(name)}: is a class of a file; in flight only planners and "
                "policies of the package fly: submit plans, or a program"
            )
        return table


class Card(FileModel):
    """The card of a submission."""

    schema_version: Literal[1] = 1
    benchmark: Text
    """Name and version of the benchmark."""
    name: Text
    """Name on the board."""
    authors: Annotated[tuple[Text, ...], Field(max_length=100)] = ()
    description: Annotated[str, Field(max_length=2000)] = ""
    url: Annotated[str, Field(max_length=500, pattern=r"^(https?://\S+)?$")] = ""
    """Page of the submission, which the board links."""
    kind: Literal["plans", "program", "in_flight"] = "plans"
    machine: Annotated[str, Field(max_length=500)] = ""
    """Machine of the planning times."""
    machine_factor: Annotated[float, Field(ge=0.05, le=20)] = 1.0
    """Times as long as the reference core that a core of that machine needs, by ``angler bench
    --workload search``; stated planning times are divided by it."""
    sets: tuple[Text, ...] = ()
    """Sets or parts of names of sets that are entered; all if left out."""
    program: ProgramConfig | None = None
    in_flight: InFlightConfig | None = None

    @model_validator(mode="after")
    def _require_table(self) -> Self:
        for kind, table in (("program", self.program), ("in_flight", self.in_flight)):
            if (self.kind == kind) != (table is not None):
                raise ValueError(
                    f"kind = {format_value(self.kind)}: the table [{kind}] must be there for "
                    f"kind = {format_value(kind)}, and for no other"
                )
        return self


def read_card(folder: Path) -> Card:
    """Read the card of a submission.

    Raises:
        ConfigError: there is none, it has faults, or it is of another benchmark.
    """
    path = folder / CARD
    if not path.is_file():
        raise ConfigError(f"{folder}: is no submission: {CARD} is missing")
    card = parse_model(Card, read_toml(path), source=str(path))
    title = problem_sets.load_benchmark().title
    if card.benchmark != title:
        raise ConfigError(
            f"{path}: benchmark = {format_value(card.benchmark)}: this program judges "
            f"{format_value(title)}"
        )
    return card


def select_entered(benchmark: FrozenBenchmark, card: Card, source: Path) -> list[ProblemSet]:
    """Return the sets that a card enters.

    Raises:
        ConfigError: a name fits no set.
    """
    try:
        return problem_sets.select_problem_sets(benchmark, card.sets)
    except ConfigError as error:
        raise ConfigError(f"{source / CARD}: sets: {error}") from error


def find_special_file(path: Path, *, links: bool) -> str:
    """Return the name of what lies in a folder and is neither file nor folder; empty if nothing.

    Pipes and devices would be read for ever; links in a file of plans may lead to files of the
    judge.

    Args:
        path: of the folder.
        links: whether links to files and folders may lie there.
    """
    for folder, folders, files in path.walk():
        for name in (*folders, *files):
            found = folder / name
            if found.is_symlink():
                if links and (found.is_file() or found.is_dir() or not found.exists()):
                    continue
            elif stat.S_IFMT(found.lstat().st_mode) in (stat.S_IFREG, stat.S_IFDIR):
                continue
            return str(found.relative_to(path.parent))
    return ""
