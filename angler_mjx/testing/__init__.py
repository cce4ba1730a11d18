"""Conformance suites of sessions and planners, the referee of runs, and validation.

The checks are plain functions, for any test runner. The names here are loaded on first use: the
referee (`angler_mjx.testing.referee`) needs neither JAX nor the simulator.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from angler_mjx.testing.conformance import (
        CHECKS,
        Check,
        NonConformanceError,
        Result,
        Skipped,
        check_session,
    )
    from angler_mjx.testing.driving import Bounds
    from angler_mjx.testing.planner_checks import check_planner

__all__ = [
    "CHECKS",
    "Bounds",
    "Check",
    "NonConformanceError",
    "Result",
    "Skipped",
    "check_planner",
    "check_session",
]

_HOME = {"Bounds": "driving", "check_planner": "planner_checks"}
"""Modules of the names that are not in `conformance`."""


def __getattr__(name: str) -> object:
    """Load a public name from its module."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    home = _HOME.get(name, "conformance")
    value: object = getattr(import_module(f"angler_mjx.testing.{home}"), name)
    return value
