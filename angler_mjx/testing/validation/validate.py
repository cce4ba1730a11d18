"""All of `angler validate`: measure, compare with what was expected, write the page."""

from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from angler_mjx.errors import ConfigError
from angler_mjx.runs.storage.atomic import replacing
from angler_mjx.testing.validation import page, results, running, speeds
from angler_mjx.testing.validation import terms as all_terms
from angler_mjx.testing.validation.judging import ValidationFault, faults
from angler_mjx.testing.validation.results import (
    Expectation,
    Expected,
    Measured,
    TermResult,
    ValidationResult,
)
from angler_mjx.testing.validation.running import Say
from angler_mjx.testing.validation.terms import EXPECTED, FOLDER, FOUND, Terms

AT_ONCE = 2
"""Studies beside the tests."""


@dataclass(frozen=True, kw_only=True)
class ValidationRequest:
    """What is asked for."""

    quick: bool = False
    """Tests that take seconds, and studies with few worlds."""
    measured: Path | None = None
    """Deviations that tests already wrote; no study is run then."""
    page_only: bool = False
    """Measure nothing: write the page again from what is stored."""
    check: bool = False
    """Compare, and write nothing."""
    store: bool = False
    """What is found becomes what is expected."""
    out: Path | None = None
    """Folder for page and JSON; those of the checkout if left out."""


@dataclass(frozen=True, kw_only=True)
class Checkout:
    """What lies in the checkout."""

    root: Path
    terms: Terms
    expected: Expected
    found: ValidationResult
    stored: Mapping[str, TermResult]

    @property
    def folder(self) -> Path:
        """Of terms, expectations and results."""
        return self.root / FOLDER


def opened(root: Path) -> Checkout:
    """Read everything that is compared with.

    Raises:
        ConfigError: a file has faults.
    """
    terms, folder = all_terms.read(root), root / FOLDER
    files = {one.name: folder / f"{one.name}.json" for one in terms.stored}
    return Checkout(
        root=root,
        terms=terms,
        expected=results.read_or_empty(Expected, folder / EXPECTED),
        found=results.read_or_empty(ValidationResult, folder / FOUND),
        stored={n: results.read(TermResult, path) for n, path in files.items() if path.exists()},
    )


def validate(request: ValidationRequest, root: Path, say: Say) -> list[ValidationFault]:
    """Measure, compare, write.

    Args:
        request: what is asked for.
        root: of the checkout.
        say: takes a line of progress.

    Returns:
        What is not as it should be; empty if all is well.

    Raises:
        ConfigError: files or the request have faults.
        RunError: a test or study could not be run.
    """
    _sensible(request)
    here = opened(root)
    measured, by_study, failed = _measure(request, here, say)
    wanted = _wanted(request, here.terms) if measured else set()
    expected = here.expected
    if request.store:
        expected = _with(expected, measured, by_study)
    bad = [ValidationFault(key=test, said="failed") for test in failed]
    bad += faults(here.terms, expected, measured, by_study, wanted)
    whole = {} if request.quick else by_study
    after = results.merged(here.found, measured, whole)
    if request.check:
        return bad + _stale_page(here)
    _write(request, here, after)
    if request.store:
        results.write(here.folder / EXPECTED, expected.model_dump())
        say(f"{here.folder / EXPECTED}")
    return bad


def _wanted(request: ValidationRequest, terms: Terms) -> set[str]:
    """Keys of terms that must have been measured; tests run by others may be those of a day."""
    return {
        term.key
        for term in terms.term
        if (term.quick or not request.quick) and not (request.measured and term.nightly)
    }


def _sensible(request: ValidationRequest) -> None:
    if request.check and (request.store or request.out or request.page_only):
        raise ConfigError("--check: writes nothing; leave out --store, --out and --page")
    if request.page_only and (request.measured or request.quick or request.store):
        raise ConfigError("--page: measures nothing; leave out --from, --quick and --store")


def _measure(
    request: ValidationRequest, here: Checkout, say: Say
) -> tuple[Measured | None, dict[str, TermResult], list[str]]:
    """What tests and studies found, and which tests failed."""
    if request.page_only:
        return None, {}, []
    if request.measured is not None:
        return results.read(Measured, request.measured), {}, []
    tests = here.terms.tests(quick=request.quick)
    say(_plan(request, here, len(tests)))
    # Side by side: each compiles on one core for most of its time, and nothing here is a timing.
    with ThreadPoolExecutor(AT_ONCE) as pool:
        begun = dict[str, Future[TermResult]]()
        for study in here.terms.study:
            arguments = study.quick if request.quick else study.arguments
            if arguments is not None:
                begun[study.name] = pool.submit(running.run_study, here.root, study, arguments, say)
        measured, failed = running.run_tests(here.root, tests, say)
        by_study = {name: study.result() for name, study in begun.items()}
    return measured, by_study, failed


def _plan(request: ValidationRequest, here: Checkout, tests: int) -> str:
    """What a person waits for, before it begins."""
    studies = [
        study.name
        for study in here.terms.study
        if (study.quick if request.quick else study.arguments) is not None
    ]
    named = f" and {len(studies)} studies ({', '.join(studies)})" if studies else ""
    long = "minutes" if request.quick else "tens of minutes on two cores"
    instead = "" if request.quick else ", --quick runs those that take seconds"
    return (
        f"runs {tests} tests{named} now: {long}. --from FILE takes what make test measured "
        f"(.cache/deviations.json) and runs nothing{instead}"
    )


def _with(
    expected: Expected, measured: Measured | None, results: dict[str, TermResult]
) -> Expected:
    """Expectations with what was found now in their place."""
    numbers = dict(expected.numbers)
    if measured is not None:
        about = measured.about
        for one in measured.deviations:
            if not isinstance(one.value, str) and one.value <= one.bound:
                numbers[one.key] = Expectation(
                    value=one.value, at_utc=about.at_utc, commit=about.commit
                )
    for name, result in results.items():
        for key, number in result.numbers.items():
            numbers[f"{name}.{key}"] = Expectation(
                value=number.value, at_utc=result.about.at_utc, commit=result.about.commit
            )
    return Expected(numbers=numbers)


def _page(here: Checkout, held: ValidationResult) -> tuple[str, str]:
    """The page as it is, and as it should be."""
    path = here.root / page.PAGE
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror or error})") from error
    table = speeds.table(here.root / speeds.RESULTS)
    bodies = page.parts(here.terms, held, here.stored, table)
    return text, page.rewritten(text, bodies, str(path))


def _stale_page(here: Checkout) -> list[ValidationFault]:
    text, right = _page(here, here.found)
    if text == right:
        return []
    said = "is not what terms, results and rows give; write it again with angler validate --page"
    return [ValidationFault(key=str(page.PAGE), said=said)]


def _write(request: ValidationRequest, here: Checkout, after: ValidationResult) -> None:
    _, text = _page(here, after)
    folder = request.out
    place = here.root / page.PAGE if folder is None else folder / page.PAGE.name
    with replacing(place, flag="--out", force=True) as writing:
        writing.write_text(text, encoding="utf-8")
    results.write((folder or here.folder) / FOUND, _joined(here, after))


def _joined(here: Checkout, after: ValidationResult) -> dict[str, Any]:
    """What is kept: what was found, without terms that are no more."""
    keys = {term.key for term in here.terms.term}
    names = {study.name for study in here.terms.study}
    kept = ValidationResult(
        tests={k: v for k, v in after.tests.items() if k in keys},
        about={k: v for k, v in after.about.items() if k in keys},
        studies={k: v for k, v in after.studies.items() if k in names},
    )
    return kept.model_dump()
