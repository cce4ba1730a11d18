"""Judgement of the validation results: comparison with their expectations."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from angler_mjx.testing.validation.results import (
    Deviation,
    Expected,
    MeasuredDeviations,
    TermResult,
)
from angler_mjx.testing.validation.terms import RegressionTolerance, Terms


@dataclass(frozen=True, kw_only=True)
class ValidationFault:
    """One number with a fault."""

    key: str
    message: str

    def __str__(self) -> str:
        """Return one line."""
        return f"{self.key}: {self.message}"


def find_faults(
    terms: Terms,
    expected: Expected,
    measured: MeasuredDeviations | None,
    results: Mapping[str, TermResult],
    required: set[str],
) -> list[ValidationFault]:
    """Return all results that got worse, were not measured, or have no expectation.

    Args:
        terms: the validated terms.
        expected: stored expectations.
        measured: deviations of the tests; None if no tests were requested.
        results: of studies, by name.
        required: keys of terms that the tests should have recorded.
    """
    all_faults = list[ValidationFault]()
    if measured is not None:
        by_key = {deviation.key: deviation for deviation in measured.deviations}
        for term in terms.term:
            deviation = by_key.get(term.key)
            if deviation is not None:
                all_faults += _check_term(deviation, terms.worse[term.worse], expected, term.unit)
            elif term.key in required:
                all_faults.append(
                    ValidationFault(key=term.key, message=f"was not measured; see {term.test}")
                )
        unknown = sorted(set(by_key) - {term.key for term in terms.term})
        all_faults += [
            ValidationFault(key=key, message="is recorded by a test, but is no term")
            for key in unknown
        ]
    for name, result in results.items():
        all_faults += _check_study(name, result, terms, expected)
    return all_faults


def _check_term(
    deviation: Deviation, worse: RegressionTolerance, expected: Expected, unit: str
) -> Iterator[ValidationFault]:
    if isinstance(deviation.value, str):
        yield ValidationFault(
            key=deviation.key,
            message=f"is {deviation.value}; asked is {deviation.bound:.3g} ({unit})",
        )
        return
    if deviation.value > deviation.bound:
        yield ValidationFault(
            key=deviation.key,
            message=f"{deviation.value:.3g} exceeds its bound of {deviation.bound:.3g} ({unit})",
        )
        return
    yield from _compare_expected(
        deviation.key,
        deviation.value,
        deviation.bound,
        worse,
        expected,
        f"{unit}; {deviation.tests[0]}",
    )


def _check_study(
    name: str, result: TermResult, terms: Terms, expected: Expected
) -> Iterator[ValidationFault]:
    for key, number in result.numbers.items():
        worse = terms.worse.get(number.worse)
        if worse is None:
            yield ValidationFault(
                key=f"{name}.{key}", message=f"no [worse.{number.worse}] in the terms"
            )
            continue
        yield from _compare_expected(
            f"{name}.{key}", number.value, None, worse, expected, number.unit
        )


def _compare_expected(
    key: str,
    value: float,
    bound: float | None,
    worse: RegressionTolerance,
    expected: Expected,
    where: str,
) -> Iterator[ValidationFault]:
    stored = expected.numbers.get(key)
    if stored is None:
        yield ValidationFault(
            key=key, message=f"{value:.3g} has no expectation; store it with --store ({where})"
        )
        return
    allowed = worse.max_allowed(stored.value, bound)
    if not value <= allowed or math.isnan(value):
        yield ValidationFault(
            key=key,
            message=(
                f"got worse: {value:.3g}, expected {stored.value:.3g}, allowed {allowed:.3g} "
                f"({where}; expected since {stored.at_utc[:10]}, "
                f"commit {(stored.commit or 'unknown')[:9]})"
            ),
        )
