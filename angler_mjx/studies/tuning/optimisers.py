"""The two searches: along the gradient (Adam), and by evolution (CMA-ES).

Both are asked for candidates and told what these are worth, and both do the same again from the
same seed and the same answers: that is how an interrupted search goes on.
"""

import importlib.util
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np

from angler_mjx.errors import UnsupportedError
from angler_mjx.robot.vehicles.thrusters import FloatArray

RATE = 0.15
"""Greatest change of a knob, the logarithm of a gain, in the first iteration of Adam."""
AVERAGING_FACTORS = (0.8, 0.95)
"""Adam's averages of the gradient and of its square: shares kept from one iteration to the next.
Shorter than usual: there are dozens of iterations, without noise."""
SIGMA = 0.4
"""Standard deviation of the knobs in the first generation of CMA-ES: gains half as large again."""


class Optimiser(Protocol):
    """A search that is asked and told."""

    needs_gradients: bool
    population: int
    """Candidates in a generation."""

    def ask(self) -> FloatArray:
        """The next candidates [population, n_knob]."""
        ...

    def tell(self, costs: Sequence[float], gradients: Sequence[Sequence[float]] | None) -> None:
        """What they are worth: costs [population], and gradients [population, n_knob]."""
        ...


class Adam:
    """Adam (Kingma and Ba 2015) within bounds, its rate falling to zero."""

    needs_gradients = True
    population = 1

    def __init__(self, low: Sequence[float], high: Sequence[float], generations: int) -> None:
        """A search that begins at 0, within bounds [n_knob] each."""
        self._low, self._high = np.asarray(low, float), np.asarray(high, float)
        self._at = np.zeros(len(self._low))
        self._mean, self._square = np.zeros_like(self._at), np.zeros_like(self._at)
        self._done, self._generations = 0, generations

    def ask(self) -> FloatArray:
        """See `Optimiser`."""
        return self._at[None].copy()

    def tell(self, costs: Sequence[float], gradients: Sequence[Sequence[float]] | None) -> None:
        """See `Optimiser`."""
        del costs
        slope = np.asarray(gradients, float)[0]
        slow, slower = AVERAGING_FACTORS
        self._mean = slow * self._mean + (1 - slow) * slope
        self._square = slower * self._square + (1 - slower) * slope**2
        rate = RATE * (1 - self._done / self._generations)
        self._done += 1
        unbiased = self._mean / (1 - slow**self._done)
        scale = np.sqrt(self._square / (1 - slower**self._done)) + 1e-12
        self._at = np.clip(self._at - rate * unbiased / scale, self._low, self._high)


class Cma:
    """CMA-ES (Hansen 2016), by the package cmaes (Nomura and Shibata 2024)."""

    needs_gradients = False

    def __init__(self, low: Sequence[float], high: Sequence[float], seed: int) -> None:
        """A search that begins about 0, within bounds [n_knob] each.

        Raises:
            UnsupportedError: the package is not installed.
        """
        require_cmaes()
        import cmaes

        self._search: Any = cmaes.CMA(
            mean=np.zeros(len(low)),
            sigma=SIGMA,
            # A knob at its bound must still be within it.
            bounds=np.stack([np.asarray(low) - 1e-9, np.asarray(high) + 1e-9], axis=1),
            seed=seed,
            population_size=max(8, 4 + int(3 * np.log(len(low)))),
        )
        self._bounds = np.asarray(low, float), np.asarray(high, float)
        self.population: int = self._search.population_size
        self._candidates: list[FloatArray] = []

    def ask(self) -> FloatArray:
        """See `Optimiser`."""
        self._candidates = [self._search.ask() for _ in range(self.population)]
        return np.clip(np.stack(self._candidates), *self._bounds)

    def tell(self, costs: Sequence[float], gradients: Sequence[Sequence[float]] | None) -> None:
        """See `Optimiser`."""
        del gradients
        self._search.tell(list(zip(self._candidates, costs, strict=True)))


def require_cmaes() -> None:
    """Refuse a search by evolution where its package is not installed.

    Raises:
        UnsupportedError: it is not.
    """
    if importlib.util.find_spec("cmaes") is None:
        raise UnsupportedError(
            "--method cma: cmaes is not installed; install the extra `tune` "
            "(pip install 'angler-mjx[tune]'), or give --method gradient"
        )
