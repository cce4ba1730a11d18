"""Flight of one scene to its end by a policy, through any session, and recorded."""

import time
from collections.abc import Callable
from dataclasses import dataclass

from angler_mjx._moved import renamed as _renamed
from angler_mjx.errors import RunError
from angler_mjx.runs.session.interface import Observation
from angler_mjx.runs.session.online_policy import OnlineFlyer, OnlineScene
from angler_mjx.runs.session.recording import RecordedCourse
from angler_mjx.sim.state import Outcome


@dataclass(frozen=True, kw_only=True)
class SessionFlight:
    """Result of a flight."""

    last: Observation
    steps: int
    wall_s: float
    broken: str = ""
    """Cause of an interruption; empty after a complete flight."""


def fly_session(
    session: OnlineScene,
    horizon_s: float,
    watch: Callable[[Observation], None] | None = None,
    flyer: OnlineFlyer | None = None,
    stopped: Callable[[], bool] = lambda: False,
) -> SessionFlight:
    """Fly until no robot runs any more, the horizon, or an interruption.

    Args:
        session: session at its reset.
        horizon_s: horizon of the scenario.
        watch: called after every step.
        flyer: source of commands; the policy of the scenario if left out.
        stopped: returns whether to stop.

    Raises:
        ConfigError: the scenario has no policy.
    """
    policy_flyer = OnlineFlyer(session) if flyer is None else flyer
    observation, steps, interruption, started_s = session.observe(), 0, "", time.perf_counter()
    while steps < round(horizon_s / session.dt_s):
        if stopped():
            interruption = "interrupted by a signal"
            break
        try:
            observation = session.step(policy_flyer.commands(observation))
        except RunError as error:  # the flight until then is kept
            interruption = str(error)
            break
        steps += 1
        if watch is not None:
            watch(observation)
        if all(status.outcome is not Outcome.RUNNING for status in observation.status):
            break
    return SessionFlight(
        last=observation, steps=steps, wall_s=time.perf_counter() - started_s, broken=interruption
    )


def build_course(flight: SessionFlight, compile_s: float) -> RecordedCourse:
    """Return the course of a flight for the summary of a run folder."""
    return RecordedCourse(
        steps=flight.steps,
        wall_s=flight.wall_s,
        compile_s=compile_s,
        more={"flown": "online"},
        interrupted=flight.broken,
    )


def __getattr__(name: str) -> object:
    """Return a name of 0.1, with a DeprecationWarning."""
    return _renamed(__name__, name)
