"""Terms of the validation: the rows of docs/validation/terms.toml."""

import math
from pathlib import Path
from typing import Literal, Self

from pydantic import Field, model_validator

from angler_mjx.errors import ConfigError
from angler_mjx.files import FileModel, parse_model, read_toml

FOLDER = Path("docs/validation")
TERMS_FILE, EXPECTED_FILE, RESULTS_FILE = "terms.toml", "expected.json", "validation.json"

type PagePart = Literal["terms", "links", "energy", "control", "engines", "clearance"]


class RegressionTolerance(FileModel):
    """Tolerance of a kind of number: excess over the expectation that counts as worse."""

    factor: float = Field(ge=1.0)
    roots: float = Field(default=0.0, ge=0.0)
    """Standard deviations of a count."""
    floor: float = Field(ge=0.0, lt=1.0)
    """Fraction of the bound below which changes are ignored."""
    reason: str

    def max_allowed(self, expected: float, bound: float | None) -> float:
        """Return the max number that is not worse; never more than the bound."""
        limit = self.factor * abs(expected)
        if self.roots:
            limit += self.roots * math.sqrt(abs(expected) + 1.0)
        if bound is None:
            return limit
        return min(max(limit, self.floor * bound), bound)


class Term(FileModel):
    """Validation term: the measured quantity of a test, and its independent reference."""

    key: str
    part: PagePart
    """Table of the page."""
    what: str
    reference: str
    unit: str
    reason: str
    """Reason of the bound that the test asserts."""
    worse: str
    test: str
    """Argument of pytest that measures the term, from the root of the checkout."""
    quick: bool = False
    nightly: bool = False
    """Whether its test runs only in full test runs."""


class StudyTerm(FileModel):
    """Study: a program that writes a result with ``--json FILE``."""

    name: str
    module: str
    arguments: tuple[str, ...] = ()
    quick: tuple[str, ...] | None = None
    """Arguments of a quick run; None where it has none."""


class StoredTerm(FileModel):
    """Stored result from elsewhere, beside the terms as NAME.json."""

    name: str
    command: str
    """Command that reproduces it."""


class Terms(FileModel):
    """Content of terms.toml."""

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
        """Return the arguments of pytest, each once."""
        selected = [term.test for term in self.term if term.quick or not quick]
        return list(dict.fromkeys(selected))


def find_checkout() -> Path:
    """Return the root of the running checkout.

    Raises:
        ConfigError: this is an installed package, which lacks the tests that measure.
    """
    root = Path(__file__).resolve().parents[3]
    if not ((root / FOLDER / TERMS_FILE).is_file() and (root / "tests").is_dir()):
        raise ConfigError(
            "angler validate: needs a checkout, because the tests are what measures; clone the "
            "repository, run `make venv` there and then .venv/bin/angler validate"
        )
    return root


def read_terms(root: Path) -> Terms:
    """Read the terms of a checkout.

    Raises:
        ConfigError: the file has faults.
    """
    path = root / FOLDER / TERMS_FILE
    return parse_model(Terms, read_toml(path), source=str(path))
