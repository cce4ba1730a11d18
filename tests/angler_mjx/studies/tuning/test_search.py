"""Searches: known optima, bounds, and going on as if nothing had happened."""

import numpy as np
import pytest

from angler_mjx.errors import UnsupportedError
from angler_mjx.studies.tuning import optimisers, search
from angler_mjx.studies.tuning.optimisers import Adam, Cma
from angler_mjx.studies.tuning.search import Generation, TuningHistory

LOW, HIGH = [-1.5, -1.5, -0.2], [1.5, 1.5, 1.5]
BEST = np.array([0.6, -0.9, -0.2])
"""Of the bowl below: the third knob would go on to -1 if it were let."""
GENERATIONS = 60


def bowl(candidates, *, gradients):
    """An elongated bowl about (0.6, -0.9, -1), 1 at the origin."""
    off = candidates - np.array([0.6, -0.9, -1.0])
    weight = np.array([1.0, 5.0, 0.3])
    scale = np.sum(weight * np.array([0.6, -0.9, -1.0]) ** 2)
    costs = np.sum(weight * off**2, axis=1) / scale
    slopes = (2 * weight * off / scale).tolist() if gradients else None
    return Generation(costs=costs.tolist(), failed=[0] * len(costs), gradients=slopes)


def made(method):
    if method == "gradient":
        return Adam(LOW, HIGH, GENERATIONS)
    return Cma(LOW, HIGH, seed=3)


@pytest.mark.parametrize("method", ["gradient", "cma"])
def test_both_searches_find_the_optimum_within_their_bounds(method):
    history = TuningHistory()
    search.run_search(made(method), bowl, history, GENERATIONS, lambda _: None)
    cost, found = history.best()
    # Each bends its steps to the bowl in a few dozen generations; 0.03 is 3 % of a gain.
    np.testing.assert_allclose(found, BEST, atol=0.03)
    assert cost == pytest.approx(bowl(BEST[None], gradients=False).costs[0], abs=2e-3)
    tried = np.concatenate([np.array(some) for some in history.settings])
    assert np.all(tried >= LOW)
    assert np.all(tried <= HIGH)


@pytest.mark.parametrize("method", ["gradient", "cma"])
def test_a_search_that_was_told_what_was_found_goes_on_as_it_would_have(method):
    whole = TuningHistory()
    search.run_search(made(method), bowl, whole, 12, lambda _: None)
    again = made(method)
    history = search.replay_history(again, whole.generations[:5])
    search.run_search(again, bowl, history, 12, lambda _: None)
    assert history == whole


def test_what_a_search_began_with_is_best_until_something_is_better():
    history = TuningHistory()
    history.settings.append([[0.5], [0.1]])
    history.generations.append(Generation(costs=[2.0, 1.0], failed=[0, 0], gradients=None))
    assert history.best() == (1.0, None)
    history.settings.append([[0.2], [0.3]])
    history.generations.append(Generation(costs=[0.8, 0.9], failed=[0, 1], gradients=None))
    assert history.best() == (0.8, [0.2])


def test_evolution_without_its_package_is_refused(monkeypatch):
    monkeypatch.setattr(optimisers.importlib.util, "find_spec", lambda _: None)
    with pytest.raises(UnsupportedError, match=r"angler-mjx\[tune\]"):
        Cma(LOW, HIGH, seed=0)
