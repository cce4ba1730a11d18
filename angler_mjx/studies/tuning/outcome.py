"""What came of a tuning: the gains as they are written, flown again before and after."""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from angler_mjx.robot.control.stack import StackGains
from angler_mjx.studies.flights.measures import FlightMeasures
from angler_mjx.studies.tuning import knobs, samples
from angler_mjx.studies.tuning.problem import TuningProblem
from angler_mjx.studies.tuning.samples import FlightSet
from angler_mjx.studies.tuning.search import TuningHistory

STIFFER = 1.5
"""What came out is also flown with every tuned gain times this: how far from trouble it is."""


@dataclass(frozen=True, kw_only=True)
class ObjectivePart:
    """A set of flights with the gains before and after."""

    flights: FlightSet
    before: FlightMeasures
    """[n] leads."""
    after: FlightMeasures
    cost: float
    """After; before is 1."""


@dataclass(frozen=True, kw_only=True)
class TuningOutcome:
    """What came of a tuning."""

    problem: TuningProblem
    history: TuningHistory
    turns: list[float]
    """[n_knob] the best settings, as they are written."""
    train: ObjectivePart
    held_out: ObjectivePart
    stiffer: ObjectivePart
    """The held-out flights with every tuned gain times ``STIFFER``, as ``after``."""
    provenance: dict[str, Any]

    @property
    def complete(self) -> bool:
        """Whether all generations were flown."""
        return len(self.history.generations) >= self.problem.settings.generations

    @property
    def gains(self) -> StackGains:
        """Of each stage, as they are written."""
        spec, changed = self.problem.spec, dict[str, dict[str, float]]()
        for knob, turn in zip(self.problem.knobs, self.turns, strict=True):
            values = zip(knob.gains, knob.values(turn), strict=True)
            changed.setdefault(knob.stage, {}).update(values)
        return tuple(
            replace(gains, **changed.get(stage.name, {}))
            for stage, gains in zip(spec.stages, spec.gains, strict=True)
        )


def measure_outcome(
    problem: TuningProblem, history: TuningHistory, provenance: dict[str, Any]
) -> TuningOutcome:
    """Fly the best candidate, and what the search began with, on both sets of flights.

    Args:
        problem: that was searched.
        history: of the search.
        provenance: of the tuning.
    """
    best = history.best()[1] or [0.0] * len(problem.knobs)
    turns = knobs.round_settings(problem.knobs, best)
    train = _measure_part(problem, problem.train, turns)
    held_out = _measure_part(problem, problem.flights(samples.HELD_OUT), turns)
    stiff = problem.fly(np.array(turns) + math.log(STIFFER), held_out.flights)
    return TuningOutcome(
        problem=problem,
        history=history,
        turns=turns,
        train=train,
        held_out=held_out,
        stiffer=_build_part(problem, held_out.flights, held_out.before, stiff),
        provenance=provenance,
    )


def _measure_part(problem: TuningProblem, flown: FlightSet, turns: list[float]) -> ObjectivePart:
    before = problem.fly(np.zeros(len(turns)), flown)
    return _build_part(problem, flown, before, problem.fly(np.array(turns), flown))


def _build_part(
    problem: TuningProblem, flown: FlightSet, before: FlightMeasures, after: FlightMeasures
) -> ObjectivePart:
    cost = problem.judge(flown, before).cost(after)
    return ObjectivePart(flights=flown, before=before, after=after, cost=cost)
