"""Which numbers got worse: what was found, held against what was expected of it."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from angler_mjx.testing.validation.results import Deviation, Expected, Measured, TermResult
from angler_mjx.testing.validation.terms import Terms, Worse


@dataclass(frozen=True, kw_only=True)
class ValidationFault:
    """One number that is not as it should be."""

    key: str
    said: str

    def __str__(self) -> str:
        """One line."""
        return f"{self.key}: {self.said}"


def faults(
    terms: Terms,
    expected: Expected,
    measured: Measured | None,
    results: Mapping[str, TermResult],
    wanted: set[str],
) -> list[ValidationFault]:
    """Everything that got worse, was not measured, or has no expectation.

    Args:
        terms: what is validated.
        expected: what was found when it was stored.
        measured: what the tests recorded; None if none were asked.
        results: of studies, by name.
        wanted: keys of terms that the tests should have recorded.
    """
    listed = list[ValidationFault]()
    if measured is not None:
        by_key = {one.key: one for one in measured.deviations}
        for term in terms.term:
            one = by_key.get(term.key)
            if one is not None:
                listed += _of_term(one, terms.worse[term.worse], expected, term.unit)
            elif term.key in wanted:
                listed.append(
                    ValidationFault(key=term.key, said=f"was not measured; see {term.test}")
                )
        unknown = sorted(set(by_key) - {term.key for term in terms.term})
        listed += [
            ValidationFault(key=key, said="is recorded by a test, but is no term")
            for key in unknown
        ]
    for name, result in results.items():
        listed += _of_study(name, result, terms, expected)
    return listed


def _of_term(
    one: Deviation, worse: Worse, expected: Expected, unit: str
) -> Iterator[ValidationFault]:
    if isinstance(one.value, str):
        yield ValidationFault(
            key=one.key, said=f"is {one.value}; asked is {one.bound:.3g} ({unit})"
        )
        return
    if one.value > one.bound:
        yield ValidationFault(
            key=one.key, said=f"{one.value:.3g} exceeds its bound of {one.bound:.3g} ({unit})"
        )
        return
    yield from _against(one.key, one.value, one.bound, worse, expected, f"{unit}; {one.tests[0]}")


def _of_study(
    name: str, result: TermResult, terms: Terms, expected: Expected
) -> Iterator[ValidationFault]:
    for key, number in result.numbers.items():
        worse = terms.worse.get(number.worse)
        if worse is None:
            yield ValidationFault(
                key=f"{name}.{key}", said=f"no [worse.{number.worse}] in the terms"
            )
            continue
        yield from _against(f"{name}.{key}", number.value, None, worse, expected, number.unit)


def _against(
    key: str, value: float, bound: float | None, worse: Worse, expected: Expected, where: str
) -> Iterator[ValidationFault]:
    held = expected.numbers.get(key)
    if held is None:
        yield ValidationFault(
            key=key, said=f"{value:.3g} has no expectation; store it with --store ({where})"
        )
        return
    allowed = worse.allowed(held.value, bound)
    if not value <= allowed or math.isnan(value):
        yield ValidationFault(
            key=key,
            said=(
                f"got worse: {value:.3g}, expected {held.value:.3g}, allowed {allowed:.3g} "
                f"({where}; expected since {held.at_utc[:10]}, "
                f"commit {(held.commit or 'unknown')[:9]})"
            ),
        )
