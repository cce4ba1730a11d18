"""One scene flown to its end by a policy, through any session, and recorded."""

import time
from collections.abc import Callable
from dataclasses import dataclass

from angler_mjx.errors import RunError
from angler_mjx.runs.session.interface import Observation
from angler_mjx.runs.session.online import OnlineFlyer, OnlineScene
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


def fly(
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
    chosen = OnlineFlyer(session) if flyer is None else flyer
    seen, steps, broken, begun = session.observe(), 0, "", time.perf_counter()
    while steps < round(horizon_s / session.dt_s):
        if stopped():
            broken = "interrupted by a signal"
            break
        try:
            seen = session.step(chosen.commands(seen))
        except RunError as error:  # what was flown until then is not lost
            broken = str(error)
            break
        steps += 1
        if watch is not None:
            watch(seen)
        if all(status.outcome is not Outcome.RUNNING for status in seen.status):
            break
    return SessionFlight(last=seen, steps=steps, wall_s=time.perf_counter() - begun, broken=broken)


def course(flown: SessionFlight, compile_s: float) -> RecordedCourse:
    """For the summary of a run folder."""
    return RecordedCourse(
        steps=flown.steps,
        wall_s=flown.wall_s,
        compile_s=compile_s,
        more={"flown": "online"},
        interrupted=flown.broken,
    )
