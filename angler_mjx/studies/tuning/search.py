"""The search itself: ask, fly, tell, keep; it can be interrupted and taken up again."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from angler_mjx.robot.vehicles.thrusters import FloatArray
from angler_mjx.studies.tuning.optimisers import Optimiser


@dataclass(frozen=True, kw_only=True)
class Generation:
    """What candidates were worth; all that an optimiser must be told to go on."""

    costs: list[float]
    """[n_candidate]."""
    failed: list[int]
    """[n_candidate] number of flights that failed."""
    gradients: list[list[float]] | None
    """[n_candidate, n_knob]; None where none were asked for."""


@dataclass(kw_only=True)
class TuningHistory:
    """What a search has seen so far; a search adds to it."""

    settings: list[list[list[float]]] = field(default_factory=list)
    """[n_generation, n_candidate, n_knob]."""
    generations: list[Generation] = field(default_factory=list)

    def best(self) -> tuple[float, list[float] | None]:
        """The least cost and its candidate: 1 and None for what the search began with."""
        cost, candidate = 1.0, None
        for generation_settings, generation in zip(self.settings, self.generations, strict=True):
            for settings, candidate_cost in zip(generation_settings, generation.costs, strict=True):
                if candidate_cost < cost:
                    cost, candidate = candidate_cost, settings
        return cost, candidate


class Evaluate(Protocol):
    """What flies candidates."""

    def __call__(self, candidates: FloatArray, *, gradients: bool) -> Generation:
        """What candidates [n, n_knob] are worth."""
        ...


def replay_history(optimiser: Optimiser, generations: Sequence[Generation]) -> TuningHistory:
    """Tell an optimiser that begins what was found before."""
    history = TuningHistory()
    for generation in generations:
        _record_generation(optimiser, history, optimiser.ask(), generation)
    return history


def run_search(
    optimiser: Optimiser,
    evaluate: Evaluate,
    history: TuningHistory,
    generations: int,
    keep: Callable[[TuningHistory], None],
) -> None:
    """Go on until so many generations are known.

    Args:
        optimiser: as `replay_history` left it.
        evaluate: flies candidates.
        history: known so far; added to.
        generations: how many there are to be.
        keep: told the history after each generation.
    """
    while len(history.generations) < generations:
        settings = optimiser.ask()
        generation = evaluate(settings, gradients=optimiser.needs_gradients)
        _record_generation(optimiser, history, settings, generation)
        keep(history)


def _record_generation(
    optimiser: Optimiser, history: TuningHistory, settings: FloatArray, generation: Generation
) -> None:
    optimiser.tell(generation.costs, generation.gradients)
    history.settings.append(settings.tolist())
    history.generations.append(generation)
