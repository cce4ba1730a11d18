"""What is to be validated: the rows of docs/validation/terms.toml."""

import math
from pathlib import Path
from typing import Literal, Self

from pydantic import Field, model_validator

from angler_mjx.errors import ConfigError
from angler_mjx.files import FileModel, parse_model, read_toml

FOLDER = Path("docs/validation")
TERMS_FILE, EXPECTED_FILE, RESULTS_FILE = "terms.toml", "expected.json", "validation.json"

type PagePart = Literal["terms", "energy", "control", "engines", "clearance"]


class RegressionTolerance(FileModel):
    """How much more than expected a number of one kind may be before it got worse."""

    factor: float = Field(ge=1.0)
    roots: float = Field(default=0.0, ge=0.0)
    """Standard deviations of a count."""
    floor: float = Field(ge=0.0, lt=1.0)
    """Share of the bound below which nothing is news."""
    reason: str

    def max_allowed(self, expected: float, bound: float | None) -> float:
        """Greatest number that is not worse; never more than the bound."""
        limit = self.factor * abs(expected)
        if self.roots:
            limit += self.roots * math.sqrt(abs(expected) + 1.0)
        if bound is None:
            return limit
        return min(max(limit, self.floor * bound), bound)


class Term(FileModel):
    """One row: what a test measures, and against which independent implementation."""

    key: str
    part: PagePart
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

    worse: dict[str, RegressionTolerance]
    term: tuple[Term, ...]
    study: tuple[StudyTerm, ...] = ()
    stored: tuple[StoredTerm, ...] = ()

    @model_validator(mode="after")
    def _check_consistent(self) -> Self:
        keys = [term.key for term in self.term]
        duplicates = {key for key in keys if keys.count(key) > 1}
        if duplicates:
            raise ValueError(f"key {', '.join(sorted(duplicates))}: given twice")
        unknown = {term.worse for term in self.term} - set(self.worse)
        if unknown:
            raise ValueError(f"worse = {', '.join(sorted(unknown))}: no [worse.NAME] of that name")
        slow = [term.key for term in self.term if term.quick and term.nightly]
        if slow:
            raise ValueError(f"key {', '.join(slow)}: cannot be both quick and nightly")
        return self

    def tests(self, *, quick: bool) -> list[str]:
        """What pytest is given, each once."""
        selected = [term.test for term in self.term if term.quick or not quick]
        return list(dict.fromkeys(selected))


def find_checkout() -> Path:
    """Root of the checkout that runs.

    Raises:
        ConfigError: this is an installed package: the tests, which are the measures, are not in it.
    """
    root = Path(__file__).resolve().parents[3]
    if not ((root / FOLDER / TERMS_FILE).is_file() and (root / "tests").is_dir()):
        raise ConfigError(
            "angler validate: needs a checkout, because the tests are what measures; clone the "
            "repository, run `make venv` there and then .venv/bin/angler validate"
        )
    return root


def read_terms(root: Path) -> Terms:
    """The terms of a checkout.

    Raises:
        ConfigError: the file has faults.
    """
    path = root / FOLDER / TERMS_FILE
    return parse_model(Terms, read_toml(path), source=str(path))
