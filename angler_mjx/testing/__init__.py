"""Conformance suites for other people's sessions: plain functions, for any test runner."""

from angler_mjx.testing.conformance import (
    CHECKS,
    Check,
    NonConformanceError,
    Result,
    Skipped,
    check_session,
)
from angler_mjx.testing.driving import Bounds

__all__ = [
    "CHECKS",
    "Bounds",
    "Check",
    "NonConformanceError",
    "Result",
    "Skipped",
    "check_session",
]
