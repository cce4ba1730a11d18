"""All trials of one controller, and the targets that they are held against."""

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from angler_mjx.studies.flights.kinds import FlightKind
from angler_mjx.studies.trials import figure_of_eight, samples, steps
from angler_mjx.studies.trials.figure_of_eight import FigureOfEight
from angler_mjx.studies.trials.samples import TrialVerdict
from angler_mjx.studies.trials.steps import TrialFlight, TrialStep

STILL_M, STILL_RAD, CURRENT_M = 0.02, math.radians(1.0), 0.05
"""Steady errors after a step: in still water, and in the current."""
EIGHT_STILL_M, EIGHT_VORTICES_M = 0.05, 0.15
"""RMS errors of the figure of eight."""


@dataclass(frozen=True, kw_only=True)
class Trial:
    """What came of all trials of one controller."""

    controller: str
    flown: TrialFlight
    eights: tuple[FigureOfEight, ...]
    verdicts: tuple[TrialVerdict, ...]
    """Of the draws; empty if none were asked for."""


def fly_trials(
    controller: str, vehicles: Sequence[FlightKind], n_sample: int, done: Callable[[int], None]
) -> Trial:
    """Fly every trial of a controller.

    Args:
        controller: name of the stack.
        vehicles: what flies steps and figures of eight.
        n_sample: number of random samples, seeds 0 to n_sample - 1.
        done: told the number of draws after each chunk.
    """
    return Trial(
        controller=controller,
        flown=steps.fly_steps(controller, vehicles),
        eights=figure_of_eight.fly_eights(controller, vehicles),
        verdicts=tuple(samples.fly_samples(controller, range(n_sample), done)),
    )


def misses_of_step(step: TrialStep) -> list[str]:
    """Targets that a step missed, in words."""
    limit_m = STILL_M if step.current_mps == 0.0 else CURRENT_M
    out = []
    if step.swings:
        out.append("oscillates")
    if not step.error_m <= limit_m:
        out.append(f"{100 * step.error_m:.3g} cm")
    if step.current_mps == 0.0 and step.error_rad > STILL_RAD:
        out.append(f"{math.degrees(step.error_rad):.2g} degrees")
    return out


def misses_of_eight(result: FigureOfEight) -> list[str]:
    """Targets that a figure of eight missed, in words."""
    limit_m = (
        EIGHT_STILL_M if result.condition == figure_of_eight.CONDITIONS[0][0] else EIGHT_VORTICES_M
    )
    return [] if result.error_m <= limit_m else [f"{100 * result.error_m:.3g} cm"]


def count_outcomes(verdicts: Sequence[TrialVerdict]) -> Counter[str]:
    """How many draws had each outcome."""
    return Counter(verdict.outcome for verdict in verdicts)
