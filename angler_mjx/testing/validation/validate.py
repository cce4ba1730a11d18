"""Main program of `angler validate`: measure, compare with expectations, write the page."""

from collections import defaultdict
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from angler_mjx.errors import ConfigError
from angler_mjx.runs.storage.atomic_files import replace_file
from angler_mjx.studies.speed import rows as speed
from angler_mjx.studies.speed.chart import device_name, format_rate
from angler_mjx.studies.speed.compare import select_latest
from angler_mjx.testing.validation import page, results, running
from angler_mjx.testing.validation import terms as all_terms
from angler_mjx.testing.validation.judging import ValidationFault, find_faults
from angler_mjx.testing.validation.results import (
    Expectation,
    Expected,
    MeasuredDeviations,
    TermResult,
    ValidationResult,
)
from angler_mjx.testing.validation.running import Report
from angler_mjx.testing.validation.terms import EXPECTED_FILE, FOLDER, RESULTS_FILE, Terms

MAX_STUDIES = 2
"""Max number of studies that run beside the tests."""


SPEED_ROWS_PATH = Path("benchmarks/results.jsonl")
SPEED_SCENARIO = "reef_fleet"
"""Scenario of the table of speeds."""


@dataclass(frozen=True, kw_only=True)
class ValidationRequest:
    """Request of a validation."""

    quick: bool = False
    """Run only tests that take seconds, and studies with few worlds."""
    measured: Path | None = None
    """Deviations of an earlier test run; no study is run then."""
    page_only: bool = False
    """Measure nothing: write the page again from the stored results."""
    check: bool = False
    """Compare, and write nothing."""
    store: bool = False
    """Store the results as new expectations."""
    out: Path | None = None
    """Folder for page and JSON; those of the checkout if left out."""


@dataclass(frozen=True, kw_only=True)
class Checkout:
    """Validation files of the checkout."""

    root: Path
    terms: Terms
    expected: Expected
    result: ValidationResult
    stored: Mapping[str, TermResult]

    @property
    def folder(self) -> Path:
        """Folder of terms, expectations and results."""
        return self.root / FOLDER


def open_checkout(root: Path) -> Checkout:
    """Read all reference data.

    Raises:
        ConfigError: a file has faults.
    """
    terms, folder = all_terms.read_terms(root), root / FOLDER
    files = {stored_term.name: folder / f"{stored_term.name}.json" for stored_term in terms.stored}
    return Checkout(
        root=root,
        terms=terms,
        expected=results.read_model_or_empty(Expected, folder / EXPECTED_FILE),
        result=results.read_model_or_empty(ValidationResult, folder / RESULTS_FILE),
        stored={
            n: results.read_model(TermResult, path) for n, path in files.items() if path.exists()
        },
    )


def run_validation(request: ValidationRequest, root: Path, report: Report) -> list[ValidationFault]:
    """Measure, compare, write.

    Args:
        request: requested options.
        root: of the checkout.
        report: receives a line of progress.

    Returns:
        All faults; empty if there are none.

    Raises:
        ConfigError: files or the request have faults.
        RunError: a test or study could not be run.
    """
    _check_request(request)
    checkout = open_checkout(root)
    measured, by_study, failed = _run_measurements(request, checkout, report)
    required = _required_keys(request, checkout.terms) if measured else set()
    expected = checkout.expected
    if request.store:
        expected = _update_expected(expected, measured, by_study)
    all_faults = [ValidationFault(key=test, message="failed") for test in failed]
    all_faults += find_faults(checkout.terms, expected, measured, by_study, required)
    study_results = {} if request.quick else by_study
    merged = results.merge_results(checkout.result, measured, study_results)
    if request.check:
        return all_faults + find_page_faults(checkout)
    _write_results(request, checkout, merged)
    if request.store:
        results.write_json(checkout.folder / EXPECTED_FILE, expected.model_dump())
        report(f"{checkout.folder / EXPECTED_FILE}")
    return all_faults


def _required_keys(request: ValidationRequest, terms: Terms) -> set[str]:
    """Return the keys of terms that must have been measured; nightly ones only in our own runs."""
    return {
        term.key
        for term in terms.term
        if (term.quick or not request.quick) and not (request.measured and term.nightly)
    }


def _check_request(request: ValidationRequest) -> None:
    if request.check and (request.store or request.out or request.page_only):
        raise ConfigError("--check: writes nothing; leave out --store, --out and --page")
    if request.page_only and (request.measured or request.quick or request.store):
        raise ConfigError("--page: measures nothing; leave out --from, --quick and --store")


def _run_measurements(
    request: ValidationRequest, checkout: Checkout, report: Report
) -> tuple[MeasuredDeviations | None, dict[str, TermResult], list[str]]:
    """Return the results of tests and studies, and the failed tests."""
    if request.page_only:
        return None, {}, []
    if request.measured is not None:
        return results.read_model(MeasuredDeviations, request.measured), {}, []
    tests = checkout.terms.tests(quick=request.quick)
    report(_describe_plan(request, checkout, len(tests)))
    # In parallel: each compiles on one core for most of its time, and no timings are taken.
    with ThreadPoolExecutor(MAX_STUDIES) as pool:
        futures = dict[str, Future[TermResult]]()
        for study in checkout.terms.study:
            arguments = study.quick if request.quick else study.arguments
            if arguments is not None:
                futures[study.name] = pool.submit(
                    running.run_study, checkout.root, study, arguments, report
                )
        measured, failed = running.run_tests(checkout.root, tests, report)
        by_study = {name: study.result() for name, study in futures.items()}
    return measured, by_study, failed


def _describe_plan(request: ValidationRequest, checkout: Checkout, tests: int) -> str:
    """Return a description of the work ahead."""
    studies = [
        study.name
        for study in checkout.terms.study
        if (study.quick if request.quick else study.arguments) is not None
    ]
    named = f" and {len(studies)} studies ({', '.join(studies)})" if studies else ""
    long = "minutes" if request.quick else "tens of minutes on two cores"
    instead = "" if request.quick else ", --quick runs those that take seconds"
    return (
        f"runs {tests} tests{named} now: {long}. --from FILE takes what make test measured "
        f"(.cache/deviations.json) and runs nothing{instead}"
    )


def _update_expected(
    expected: Expected, measured: MeasuredDeviations | None, results: dict[str, TermResult]
) -> Expected:
    """Return the expectations, updated with the new results."""
    numbers = dict(expected.numbers)
    if measured is not None:
        about = measured.about
        for deviation in measured.deviations:
            if not isinstance(deviation.value, str) and deviation.value <= deviation.bound:
                numbers[deviation.key] = Expectation(
                    value=deviation.value, at_utc=about.at_utc, commit=about.commit
                )
    for name, result in results.items():
        for key, number in result.numbers.items():
            numbers[f"{name}.{key}"] = Expectation(
                value=number.value, at_utc=result.about.at_utc, commit=result.about.commit
            )
    return Expected(numbers=numbers)


def _build_page(checkout: Checkout, result: ValidationResult) -> tuple[str, str]:
    """Return the current page, and the new one."""
    path = checkout.root / page.PAGE_PATH
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror or error})") from error
    table = build_speed_table(checkout.root / SPEED_ROWS_PATH)
    bodies = page.build_parts(checkout.terms, result, checkout.stored, table)
    return text, page.rewrite_page(text, bodies, str(path))


def find_page_faults(checkout: Checkout) -> list[ValidationFault]:
    """Find out whether the page is what terms, results and rows of speed give.

    Returns:
        One fault, or none.

    Raises:
        ConfigError: the page or a file that it is made from cannot be read.
    """
    text, expected = _build_page(checkout, checkout.result)
    if text == expected:
        return []
    message = "is not what terms, results and rows give; write it again with angler validate --page"
    return [ValidationFault(key=str(page.PAGE_PATH), message=message)]


def _write_results(
    request: ValidationRequest, checkout: Checkout, merged: ValidationResult
) -> None:
    _, text = _build_page(checkout, merged)
    folder = request.out
    page_path = checkout.root / page.PAGE_PATH if folder is None else folder / page.PAGE_PATH.name
    with replace_file(page_path, flag="--out", force=True) as writing:
        writing.write_text(text, encoding="utf-8")
    results.write_json(
        (folder or checkout.folder) / RESULTS_FILE, _current_results(checkout, merged)
    )


def _current_results(checkout: Checkout, merged: ValidationResult) -> dict[str, object]:
    """Return the results to keep: all without those of removed terms."""
    keys = {term.key for term in checkout.terms.term}
    names = {study.name for study in checkout.terms.study}
    kept = ValidationResult(
        tests={k: v for k, v in merged.tests.items() if k in keys},
        about={k: v for k, v in merged.about.items() if k in keys},
        studies={k: v for k, v in merged.studies.items() if k in names},
    )
    return kept.model_dump()


def is_traceable(row: Mapping[str, object]) -> bool:
    """Return whether a row names its commit, and the tree was unchanged."""
    return bool(row["commit"]) and not str(row["commit"]).endswith("-changed")


def build_speed_table(results: Path) -> str:
    """Return simulation and preparation speeds of the demo's scenario by device and size.

    Args:
        results: file of rows; rows without a commit or from a changed tree are left out.

    Raises:
        ConfigError: the file cannot be read.
    """
    rows = select_latest([row for row in speed.read_rows(results) if is_traceable(row)])
    medians: dict[tuple[str, int, int], dict[str, str]] = defaultdict(dict)
    for row in rows:
        if row["workload"] == SPEED_SCENARIO:
            name = str(row["engine"])
        elif row["workload"] == f"preparation/{SPEED_SCENARIO}":
            name = "preparation"
        else:
            continue
        text = f"{format_rate(row['median'])} ({row['commit'][:7]})"
        medians[device_name(row), row["worlds"], row["robots"]][name] = text
    head = (
        "| device | worlds x robots | mjx, vehicle-steps/s | fused, vehicle-steps/s "
        "| drawing and planning, worlds/s |\n| --- | ---: | ---: | ---: | ---: |"
    )
    lines = [
        f"| {device} | {worlds:,} x {robots} | "
        + " | ".join(by_engine.get(name, "-") for name in ("mjx", "fused", "preparation"))
        + " |"
        for (device, worlds, robots), by_engine in sorted(medians.items())
    ]
    return "\n".join([head, *lines])
