"""One scene flown to its end by a policy, through any session, and recorded."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from angler_mjx._moved import renamed as _renamed
from angler_mjx.errors import RunError
from angler_mjx.runs.session.interface import Observation
from angler_mjx.runs.session.online_policy import OnlineFlyer, OnlineScene
from angler_mjx.runs.session.recording import RecordedCourse
from angler_mjx.sim.state import Outcome


@dataclass(frozen=True, kw_only=True)
class SessionFlight:
    """How it went."""

    last: Observation
    steps: int
    wall_s: float
    broken: str = ""
    """What broke it off; empty if it came to its end."""


def fly_session(
    session: OnlineScene,
    horizon_s: float,
    watch: Callable[[Observation], None] | None = None,
    flyer: OnlineFlyer | None = None,
    stopped: Callable[[], bool] = lambda: False,
) -> SessionFlight:
    """Fly until no robot runs any more, or the horizon, or something breaks it off.

    Args:
        session: at its reset.
        horizon_s: of the scenario.
        watch: told of every step.
        flyer: that commands; by the policy of the scenario if left out.
        stopped: whether somebody asked for the end.

    Raises:
        ConfigError: the scenario asks for no policy.
    """
    policy_flyer = OnlineFlyer(session) if flyer is None else flyer
    observation, steps, interruption, started_s = session.observe(), 0, "", time.perf_counter()
    while steps < round(horizon_s / session.dt_s):
        if stopped():
            interruption = "interrupted by a signal"
            break
        try:
            observation = session.step(policy_flyer.commands(observation))
        except RunError as error:  # what was flown until then is not lost
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
    """For the summary of a run folder."""
    return RecordedCourse(
        steps=flight.steps,
        wall_s=flight.wall_s,
        compile_s=compile_s,
        more={"flown": "online"},
        interrupted=flight.broken,
    )


def __getattr__(name: str) -> Any:
    """Return what had another name before 0.2."""
    return _renamed(__name__, name)
