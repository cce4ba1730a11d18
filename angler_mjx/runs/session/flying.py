"""One scene flown to its end by a policy, through any session, and recorded."""

import time
from collections.abc import Callable
from dataclasses import dataclass

from angler_mjx.errors import RunError
from angler_mjx.runs.session.interface import Observation
from angler_mjx.runs.session.online import Flyer, Scene
from angler_mjx.runs.session.recording import Course
from angler_mjx.sim.state import Outcome


@dataclass(frozen=True, kw_only=True)
class Flown:
    """How it went."""

    last: Observation
    steps: int
    wall_s: float
    broken: str = ""
    """What broke it off; empty if it came to its end."""


def fly(
    session: Scene,
    horizon_s: float,
    watch: Callable[[Observation], None] | None = None,
    flyer: Flyer | None = None,
    stopped: Callable[[], bool] = lambda: False,
) -> Flown:
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
    chosen = Flyer(session) if flyer is None else flyer
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
    return Flown(last=seen, steps=steps, wall_s=time.perf_counter() - begun, broken=broken)


def course(flown: Flown, compile_s: float) -> Course:
    """For the summary of a run folder."""
    return Course(
        steps=flown.steps,
        wall_s=flown.wall_s,
        compile_s=compile_s,
        more={"flown": "online"},
        interrupted=flown.broken,
    )
