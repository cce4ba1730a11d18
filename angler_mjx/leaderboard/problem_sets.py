"""The frozen benchmark: its file, its sets of problems, and the scenario of each set.

A set is a team size, an environment, a condition of the water and an information level; its
problems are the first worlds of one seed. Public seeds come from the names of the benchmark and of
the set, hidden ones from an organiser's secret as well.
"""

import hashlib
import hmac
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from angler_mjx.errors import ConfigError, format_value
from angler_mjx.files import FOLDER_CONTEXT, FileModel, parse_model, read_toml
from angler_mjx.scenario.editing import merge_tables
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.scenario.tables import InformationConfig

FILE = "angler_1.toml"
PUBLIC = b""
"""Secret of the public problems."""


class TeamTier(FileModel):
    """Problems with teams of one size."""

    robots: Annotated[int, Field(ge=1)]
    problems: Annotated[int, Field(ge=1)]
    """Problems in each set with this team."""
    limit_s: Annotated[float, Field(gt=0)]
    """Planning time for a problem, s."""


class WaterCondition(FileModel):
    """WaterCondition of the water: what moves, and which information levels problems have."""

    name: str
    information: tuple[str, ...]
    world: dict[str, Any] = Field(default_factory=dict)
    """Keys of the scenario's ``world``."""


class FrozenBenchmark(FileModel):
    """The benchmark's file."""

    schema_version: int
    name: str
    version: str
    """Version of problems and physics."""
    environments: tuple[str, ...]
    """Presets of worlds."""
    team: tuple[TeamTier, ...]
    information: dict[str, InformationConfig]
    """Information levels by their names in names of sets."""
    condition: tuple[WaterCondition, ...]
    scenario: dict[str, Any]
    """Keys of a scenario that all sets share."""

    @property
    def title(self) -> str:
        """Return name and version."""
        return f"{self.name} {self.version}"


@dataclass(frozen=True, kw_only=True)
class ProblemSet:
    """Problems that differ in their worlds only."""

    name: str
    """ENVIRONMENT-CONDITION-INFORMATION-ROBOTS, as names of files have it."""
    environment: str
    condition: str
    information: str
    robots: int
    problems: int
    limit_s: float
    """Planning time for a problem, s."""

    def problem_names(self) -> list[str]:
        """Return the names of the problems."""
        return [f"{self.name}/{world}" for world in range(self.problems)]


def single_problem(entry: ProblemSet) -> ProblemSet:
    """Return a set of the same kind with one problem."""
    return replace(entry, problems=1)


def data_folder() -> Path:
    """Return the folder of the benchmark's files."""
    return Path(str(resources.files("angler_mjx.leaderboard"))) / "data"


@cache
def load_benchmark() -> FrozenBenchmark:
    """Read the frozen benchmark."""
    path = data_folder() / FILE
    return parse_model(FrozenBenchmark, read_toml(path), source=str(path))


def list_problem_sets(benchmark: FrozenBenchmark) -> list[ProblemSet]:
    """Return the sets, small teams first."""
    return [
        ProblemSet(
            name=f"{environment}-{condition.name}-{information}-{team.robots:02d}",
            environment=environment,
            condition=condition.name,
            information=information,
            robots=team.robots,
            problems=team.problems,
            limit_s=team.limit_s,
        )
        for team in benchmark.team
        for environment in benchmark.environments
        for condition in benchmark.condition
        for information in condition.information
    ]


def select_problem_sets(benchmark: FrozenBenchmark, patterns: tuple[str, ...]) -> list[ProblemSet]:
    """Return the sets that a person names: by whole names or by parts between hyphens.

    Args:
        benchmark: the benchmark.
        patterns: names such as reef-still-known-04, or parts such as reef, still or 04; a set is
            selected if it has all parts of one of them; all sets if there is none.

    Raises:
        ConfigError: a name fits no set.
    """
    sets = list_problem_sets(benchmark)
    if not patterns:
        return sets
    selected: set[str] = set()
    for pattern in patterns:
        parts = {part.zfill(2) if part.isdecimal() else part for part in pattern.split("-")}
        fitting = [entry.name for entry in sets if parts <= set(entry.name.split("-"))]
        if not fitting:
            raise ConfigError(
                f"--sets {format_value(pattern)}: no problem set has these parts; a name is "
                f"{' or '.join(benchmark.environments)}, then "
                f"{' or '.join(condition.name for condition in benchmark.condition)}, then "
                f"{' or '.join(benchmark.information)}, then the number of robots, as in "
                f"{sets[0].name}"
            )
        selected.update(fitting)
    return [entry for entry in sets if entry.name in selected]


def derive_seed(benchmark: FrozenBenchmark, name: str, secret: bytes, attempt: int) -> int:
    """Return the seed of a set's worlds, from 0 to 2**31 - 1.

    HMAC-SHA256 (RFC 2104) of ``NAME VERSION/SET/ATTEMPT`` under the secret; its first 31 bits,
    the most significant first. Attempts count from 0; the first seed is taken whose worlds all hold
    the team.

    Args:
        benchmark: the benchmark.
        name: name of the set.
        secret: secret of the organiser; empty for the public problems.
        attempt: number of seeds of this set that were refused.
    """
    text = f"{benchmark.title}/{name}/{attempt}".encode()
    return int.from_bytes(hmac.new(secret, text, hashlib.sha256).digest()[:4], "big") >> 1


def digest_secret(secret: bytes) -> str:
    """Return what an organiser may publish of a secret beforehand: its SHA-256, hexadecimal."""
    return hashlib.sha256(secret).hexdigest()


def build_scenario(benchmark: FrozenBenchmark, entry: ProblemSet, seed: int) -> Scenario:
    """Return the scenario of a set, whose worlds 0, 1, ... are its problems.

    Args:
        benchmark: the benchmark.
        entry: the set.
        seed: of its worlds.
    """
    condition = next(item for item in benchmark.condition if item.name == entry.condition)
    shared: Mapping[str, Any] = benchmark.scenario
    fleet = [{**member, "count": entry.robots} for member in shared["fleet"]]
    table = merge_tables(
        shared,
        {
            "name": entry.name,
            "worlds": entry.problems,
            "seed": seed,
            "fleet": fleet,
            "world": {**condition.world, "preset": entry.environment},
            "planner": {
                "deadline_s": entry.limit_s,
                "information": benchmark.information[entry.information].model_dump(),
            },
        },
    )
    source = f"{FILE} ({entry.name})"
    return parse_model(Scenario, table, source=source, context={FOLDER_CONTEXT: data_folder()})
