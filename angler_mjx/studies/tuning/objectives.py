r"""Objectives: one number for a candidate, from the measures of its flights.

Flights form groups, a robot on a course. Measures count as shares of what the gains that the search
began with had in the mean of the group, so that a slow vehicle weighs no more than a quick one, and
a step no more than a figure of eight; $J = 1$ is what one began with. With $r_i$ the share of the
ISE of flight i, and $e_i$ that of energy by metre:

- ``ise``: $J = \overline{r_i}$
- ``energy``: $J = \frac{1}{2} (\overline{r_i} + \overline{e_i})$
- ``robust``: $J$ = the mean of the worst tenth (conditional value at risk, Rockafellar and
  Uryasev 2000) of $r_i + (s_i / 5 cm)^2 + (u_i / 20 us)^2$, with $s_i$ the swing of a vehicle that
  is to stand still and $u_i$ the jitter of the thrusters' signals; divided by what one began with.

Bars are means over groups of the mean in each. A flight that fails counts 100, in place of its
share; none counts more.
"""

from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike, NDArray

from angler_mjx.robot.vehicles.thrusters import FloatArray
from angler_mjx.studies.flights.measures import FlightMeasures
from angler_mjx.studies.tuning.flying import GRADIENT_MEASURES

type Objective = Literal["ise", "energy", "robust"]

FAILED_COST = 100.0
TAIL_FRACTION = 0.1
SWING_M, JITTER_US = 0.05, 20.0


@dataclass(frozen=True, kw_only=True)
class RelativeObjective:
    """An objective with what it is relative to."""

    objective: Objective
    group: NDArray[np.int64]
    """int [n] of the flights."""
    ise_m2s: FloatArray
    """[n] mean of the group of each flight, with the gains that the search began with."""
    energy_jpm: FloatArray
    """[n]."""
    scale: float = 1.0
    """What the gains that the search began with have."""

    def costs(self, measures: FlightMeasures) -> FloatArray:
        """J [c] of c candidates from measures [c, n]."""
        cost = jax.vmap(partial(_total_cost, self))(
            _gradient_measures(measures), jnp.asarray(measures.failed)
        )
        return np.asarray(cost, float) / self.scale

    def cost(self, measures: FlightMeasures) -> float:
        """J of one candidate from measures [n]."""
        batch = jax.tree.map(lambda leaf: np.asarray(leaf)[None], measures)
        return float(self.costs(batch)[0])

    def gradients(self, measures: FlightMeasures, slopes: dict[str, FloatArray]) -> FloatArray:
        """Derivatives [c, n_knob] of J from those [c, n, n_knob] of the measures."""
        of_measures = jax.vmap(jax.grad(partial(_total_cost, self)))(
            _gradient_measures(measures), jnp.asarray(measures.failed)
        )
        # A flight that fails, or whose derivatives overflow, has nothing to say.
        lost = np.asarray(measures.failed) | ~np.isfinite(
            sum(x.sum(axis=-1) for x in slopes.values())
        )
        gradient: FloatArray = np.zeros((lost.shape[0], next(iter(slopes.values())).shape[-1]))
        for name, weight in of_measures.items():
            sound = _zero_failed(np.asarray(slopes[name], float), lost)
            gradient += np.einsum("cn,cnk->ck", np.asarray(weight, float), sound)
        return gradient / self.scale


def build_objective(
    objective: Objective, group: NDArray[np.int64], start: FlightMeasures
) -> RelativeObjective:
    """An objective, relative to the measures [n] of the gains that the search begins with."""
    sound = ~np.asarray(start.failed)

    def means(values: FloatArray) -> FloatArray:
        # A group in which every flight fails is measured by all the others.
        every = float(values[sound].mean()) if sound.any() else 1.0
        of_group = {
            g: float(values[sound & (group == g)].mean()) if sound[group == g].any() else every
            for g in np.unique(group)
        }
        return np.array([of_group[g] for g in group])

    relative = RelativeObjective(
        objective=objective,
        group=group,
        ise_m2s=means(np.asarray(start.ise_m2s, float)),
        energy_jpm=means(np.asarray(start.energy_jpm, float)),
    )
    return replace(relative, scale=relative.cost(start))


def _gradient_measures(measures: FlightMeasures) -> dict[str, jax.Array]:
    """The measures that count; 0 in flights that fail, whose numbers mean nothing."""
    return {
        name: jnp.asarray(_zero_failed(getattr(measures, name), measures.failed))
        for name in GRADIENT_MEASURES
    }


def _zero_failed(values: ArrayLike, failed: ArrayLike) -> FloatArray:
    bad = np.asarray(failed).reshape(*np.shape(failed), *[1] * (np.ndim(values) - 2))
    return np.where(bad, 0.0, values)


def _flight_costs(
    objective: RelativeObjective, measures: dict[str, jax.Array], failed: jax.Array
) -> jax.Array:
    """What each of n flights counts, [n]."""
    cost = measures["ise_m2s"] / jnp.asarray(objective.ise_m2s)
    if objective.objective == "energy":
        cost = 0.5 * (cost + measures["energy_jpm"] / jnp.asarray(objective.energy_jpm))
    if objective.objective == "robust":
        cost += (measures["swing_m"] / SWING_M) ** 2 + (measures["jitter_us"] / JITTER_US) ** 2
    return jnp.where(failed, FAILED_COST, jnp.minimum(cost, FAILED_COST))


def _total_cost(
    objective: RelativeObjective, measures: dict[str, jax.Array], failed: jax.Array
) -> jax.Array:
    """J [] of n flights, not yet relative."""
    costs = _flight_costs(objective, measures, failed)
    if objective.objective == "robust":
        worst = max(1, round(TAIL_FRACTION * costs.shape[0]))
        return jnp.mean(jnp.sort(costs)[-worst:])
    _, number, count = np.unique(objective.group, return_inverse=True, return_counts=True)
    return jnp.sum(costs / jnp.asarray(count[number] * len(count), costs.dtype))
