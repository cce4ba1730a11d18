"""Opener of vehicles behind endpoints for `angler_mjx.serve`."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

from angler_mjx.errors import ConfigError
from angler_mjx.files import JsonTable
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.teleop.opening import OpenedSession, Report, SessionOpener
from angler_sitl.endpoints.session import EndpointSession, EndpointSettings

ARM_WORD = "arm"
"""Word that confirms that motors may turn."""


def build_endpoint_opener(
    settings: EndpointSettings, *, arm: bool, follow_plans: bool, read_line: Callable[[], str]
) -> SessionOpener:
    """Build the opener of a session over vehicles that somebody else started.

    Args:
        settings: vehicles and limits.
        arm: whether to arm before the first step, once a person has confirmed it.
        follow_plans: whether armed robots go to their plans at once.
        read_line: reads the confirmation.
    """

    def open_session(
        scenario: Scenario, world: int, logs: Path | None, report: Report | None
    ) -> OpenedSession:
        inform: Report = report or (lambda _: None)
        session = EndpointSession(scenario, settings, world=world, logs=logs)
        for vehicle in session.describe():
            inform(str(vehicle))
        inform(session.describe_limits())

        def begin() -> None:
            if not arm:
                inform("not armed: vehicles are observed alone; --arm arms them")
                return
            confirm_arming(len(session.robots), inform, read_line)
            session.arm()
            inform("armed in GUIDED; Ctrl-C ends the flight")
            if follow_plans:
                for robot in range(len(session.robots)):
                    session.resume_plan(robot)

        return OpenedSession(
            session=session, is_real=True, begin=begin, finish=partial(_finish, session, inform)
        )

    return open_session


def confirm_arming(robots: int, report: Report, read_line: Callable[[], str]) -> None:
    """Have a person confirm that motors may turn.

    Raises:
        ConfigError: the answer is another.
    """
    vehicles = "1 vehicle" if robots == 1 else f"{robots} vehicles"
    report(
        f"the motors of {vehicles} will turn: see that nobody is near a propeller, then type "
        f"{ARM_WORD} and Enter"
    )
    if read_line().strip().lower() != ARM_WORD:
        raise ConfigError(f"--arm: not confirmed; the answer must be {ARM_WORD}")


def _finish(session: EndpointSession, report: Report) -> JsonTable:
    session.finish()
    for name, outcome in session.outcomes.items():
        report(f"{name}: {outcome}")
    if session.end_note:
        report(session.end_note)
    return {"vehicles": session.summarise()}
