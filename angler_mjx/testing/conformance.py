"""Conformance checks of any session, and the suite of all checks.

A check drives one robot of a session through its public methods alone, so it holds for a simulator
and for real autopilots; `Bounds` holds the limits of their physics. The scene should be calm
(little current, nothing that moves), with free water around the robot's start.
"""

from collections.abc import Callable, Collection
from dataclasses import dataclass

from angler_mjx.runs.session.interface import Session
from angler_mjx.testing import refusals, session_checks
from angler_mjx.testing.driving import Bounds, NonConformanceError, Skipped

__all__ = [
    "CHECKS",
    "Bounds",
    "Check",
    "NonConformanceError",
    "Result",
    "Skipped",
    "check_session",
]


@dataclass(frozen=True, kw_only=True)
class Check:
    """Check of one requirement of a session."""

    name: str
    asserts: str
    """Requirement, in words."""
    run: Callable[[Session, Bounds], None]
    """Function of the check. Resets the session first. Raises NonConformanceError, or Skipped."""


@dataclass(frozen=True, kw_only=True)
class Result:
    """Result of one check."""

    name: str
    skipped: str = ""
    """Reason, if it was skipped."""
    fault: str = ""
    """Failed requirement; empty if there is none."""


def _build_check(run: Callable[[Session, Bounds], None]) -> Check:
    """Return the check of a function: its name, and the first line of its docstring."""
    description = (run.__doc__ or "").strip().splitlines()[0]
    return Check(name=run.__name__, asserts=description, run=run)


CHECKS: tuple[Check, ...] = tuple(
    _build_check(run)
    for run in (
        session_checks.reset_repeats,
        session_checks.time_advances,
        session_checks.observing_changes_nothing,
        session_checks.commands_are_latched,
        session_checks.twists_are_in_the_body_frame,
        session_checks.poses_are_reached,
        session_checks.wrenches_push,
        session_checks.neutral_signals_let_it_drift,
        session_checks.trajectories_are_followed_and_held,
        session_checks.trajectories_are_replaced_smoothly,
        session_checks.plans_are_taken_up_again_smoothly,
        refusals.bad_commands_are_refused,
        refusals.a_refused_robot_holds_and_others_go_on,
        refusals.robots_that_are_not_there_are_refused,
        refusals.a_closed_session_is_closed,
    )
)
"""All checks; the last one closes the session."""


def check_session(
    make_session: Callable[[], Session],
    *,
    bounds: Bounds | None = None,
    only: Collection[str] | None = None,
) -> tuple[Result, ...]:
    """Run every check on a session.

    Args:
        make_session: makes the session to check; it is called once, and the session is
            closed at the end.
        bounds: limits of the checks.
        only: names of the checks to run; all of them if left out.

    Returns:
        The result of each check, passed or skipped with the reason, if none fails.

    Raises:
        NonConformanceError: naming every failed check with its fault.
    """
    session, limits = make_session(), bounds or Bounds()
    results, closing = [], refusals.a_closed_session_is_closed.__name__
    for check in CHECKS:
        if only is not None and check.name not in only:
            continue
        try:
            check.run(session, limits)
        except Skipped as reason:
            results.append(Result(name=check.name, skipped=str(reason)))
        except NonConformanceError as fault:
            results.append(Result(name=check.name, fault=str(fault)))
        else:
            results.append(Result(name=check.name))
    if only is not None and closing not in only:
        session.close()
    if faults := [f"{result.name}: {result.fault}" for result in results if result.fault]:
        raise NonConformanceError(
            "\n".join([f"{len(faults)} of {len(results)} checks failed", *faults])
        )
    return tuple(results)
