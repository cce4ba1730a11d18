"""What is to be validated: the rows of docs/validation/terms.toml."""

import math
from pathlib import Path
from typing import Literal, Self

from pydantic import Field, model_validator

from angler_mjx.errors import ConfigError
from angler_mjx.files import FileModel, parse, read_toml

FOLDER = Path("docs/validation")
TERMS, EXPECTED, FOUND = "terms.toml", "expected.json", "validation.json"

type Part = Literal["terms", "energy", "control", "engines", "clearance"]


class Worse(FileModel):
    """How much more than expected a number of one kind may be before it got worse."""

    factor: float = Field(ge=1.0)
    roots: float = Field(default=0.0, ge=0.0)
    """Standard deviations of a count."""
    floor: float = Field(ge=0.0, lt=1.0)
    """Share of the bound below which nothing is news."""
    reason: str

    def allowed(self, expected: float, bound: float | None) -> float:
        """Greatest number that is not worse; never more than the bound."""
        most = self.factor * abs(expected)
        if self.roots:
            most += self.roots * math.sqrt(abs(expected) + 1.0)
        if bound is None:
            return most
        return min(max(most, self.floor * bound), bound)


class Term(FileModel):
    """One row: what a test measures, and against which independent implementation."""

    key: str
    part: Part
    """Table of the page."""
    what: str
    reference: str
    unit: str
    reason: str
    """Of the bound that the test asserts."""
    worse: str
    test: str
    """What pytest is given to have it measured, from the root of the checkout."""
    quick: bool = False
    nightly: bool = False
    """Whether its test runs only where all are asked for."""


class StudyTerm(FileModel):
    """A program that writes a result with ``--json FILE``."""

    name: str
    module: str
    arguments: tuple[str, ...] = ()
    quick: tuple[str, ...] | None = None
    """Arguments of a quick run; None where it has none."""


class StoredTerm(FileModel):
    """A result that comes from elsewhere and lies beside the terms as NAME.json."""

    name: str
    command: str
    """How it is made again."""


class Terms(FileModel):
    """The whole file."""

    worse: dict[str, Worse]
    term: tuple[Term, ...]
    study: tuple[StudyTerm, ...] = ()
    stored: tuple[StoredTerm, ...] = ()

    @model_validator(mode="after")
    def _hangs_together(self) -> Self:
        keys = [term.key for term in self.term]
        double = {key for key in keys if keys.count(key) > 1}
        if double:
            raise ValueError(f"key {', '.join(sorted(double))}: given twice")
        unknown = {term.worse for term in self.term} - set(self.worse)
        if unknown:
            raise ValueError(f"worse = {', '.join(sorted(unknown))}: no [worse.NAME] of that name")
        slow = [term.key for term in self.term if term.quick and term.nightly]
        if slow:
            raise ValueError(f"key {', '.join(slow)}: cannot be both quick and nightly")
        return self

    def tests(self, *, quick: bool) -> list[str]:
        """What pytest is given, each once."""
        wanted = [term.test for term in self.term if term.quick or not quick]
        return list(dict.fromkeys(wanted))


def checkout() -> Path:
    """Root of the checkout that runs.

    Raises:
        ConfigError: this is an installed package: the tests, which are the measures, are not in it.
    """
    root = Path(__file__).resolve().parents[3]
    if not ((root / FOLDER / TERMS).is_file() and (root / "tests").is_dir()):
        raise ConfigError(
            "angler validate: needs a checkout, because the tests are what measures; clone the "
            "repository, run `make venv` there and then .venv/bin/angler validate"
        )
    return root


def read(root: Path) -> Terms:
    """The terms of a checkout.

    Raises:
        ConfigError: the file has faults.
    """
    path = root / FOLDER / TERMS
    return parse(Terms, read_toml(path), source=str(path))
