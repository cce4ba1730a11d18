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
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np

from angler_mjx.robot.vehicles.thrusters import FloatArray
from angler_mjx.studies.flights.measures import Measures
from angler_mjx.studies.tuning.flying import SLOPED

type Objective = Literal["ise", "energy", "robust"]

FAILED = 100.0
TAIL = 0.1
SWING_M, JITTER_US = 0.05, 20.0


@dataclass(frozen=True, kw_only=True)
class Judge:
    """An objective with what it is relative to."""

    objective: Objective
    group: FloatArray
    """int [n] of the flights."""
    ise_m2s: FloatArray
    """[n] mean of the group of each flight, with the gains that the search began with."""
    energy_jpm: FloatArray
    """[n]."""
    scale: float = 1.0
    """What the gains that the search began with have."""

    def costs(self, found: Measures) -> FloatArray:
        """J [c] of c candidates from measures [c, n]."""
        cost = jax.vmap(partial(_cost, self))(_sloped(found), jnp.asarray(found.failed))
        return np.asarray(cost, float) / self.scale

    def cost(self, found: Measures) -> float:
        """J of one candidate from measures [n]."""
        one = jax.tree.map(lambda leaf: np.asarray(leaf)[None], found)
        return float(self.costs(one)[0])

    def gradients(self, found: Measures, slopes: dict[str, FloatArray]) -> FloatArray:
        """Derivatives [c, n_knob] of J from those [c, n, n_knob] of the measures."""
        of_measures = jax.vmap(jax.grad(partial(_cost, self)))(
            _sloped(found), jnp.asarray(found.failed)
        )
        # A flight that fails, or whose derivatives overflow, has nothing to say.
        lost = np.asarray(found.failed) | ~np.isfinite(sum(x.sum(axis=-1) for x in slopes.values()))
        gradient: FloatArray = np.zeros((lost.shape[0], next(iter(slopes.values())).shape[-1]))
        for name, weight in of_measures.items():
            sound = _sound(np.asarray(slopes[name], float), lost)
            gradient += np.einsum("cn,cnk->ck", np.asarray(weight, float), sound)
        return gradient / self.scale


def judge(objective: Objective, group: FloatArray, start: Measures) -> Judge:
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

    relative = Judge(
        objective=objective,
        group=group,
        ise_m2s=means(np.asarray(start.ise_m2s, float)),
        energy_jpm=means(np.asarray(start.energy_jpm, float)),
    )
    return replace(relative, scale=relative.cost(start))


def _sloped(found: Measures) -> dict[str, jax.Array]:
    """The measures that count; 0 in flights that fail, whose numbers mean nothing."""
    return {name: jnp.asarray(_sound(getattr(found, name), found.failed)) for name in SLOPED}


def _sound(values: Any, failed: Any) -> FloatArray:
    bad = np.asarray(failed).reshape(*np.shape(failed), *[1] * (np.ndim(values) - 2))
    return np.where(bad, 0.0, values)


def _shares(judge: Judge, found: dict[str, jax.Array], failed: jax.Array) -> jax.Array:
    """What each of n flights counts, [n]."""
    share = found["ise_m2s"] / jnp.asarray(judge.ise_m2s)
    if judge.objective == "energy":
        share = 0.5 * (share + found["energy_jpm"] / jnp.asarray(judge.energy_jpm))
    if judge.objective == "robust":
        share += (found["swing_m"] / SWING_M) ** 2 + (found["jitter_us"] / JITTER_US) ** 2
    return jnp.where(failed, FAILED, jnp.minimum(share, FAILED))


def _cost(judge: Judge, found: dict[str, jax.Array], failed: jax.Array) -> jax.Array:
    """J [] of n flights, not yet relative."""
    share = _shares(judge, found, failed)
    if judge.objective == "robust":
        worst = max(1, round(TAIL * share.shape[0]))
        return jnp.mean(jnp.sort(share)[-worst:])
    _, number, count = np.unique(judge.group, return_inverse=True, return_counts=True)
    return jnp.sum(share / jnp.asarray(count[number] * len(count), share.dtype))
