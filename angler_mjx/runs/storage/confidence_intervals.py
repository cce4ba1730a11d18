"""95 % intervals of rates whose robots share worlds: a world is easy or hard for all of them.

Robots of one world are not independent, so n of them are worth fewer: n / d, with the design effect
d = (variance of the rate between worlds) / (variance that n independent robots would have), the
first by the linearised estimator of a ratio (Cochran, Sampling Techniques, 1977, eq. 6.13),

    m / (m - 1) sum_w (x_w - p n_w)^2 / n^2,    m worlds with n_w robots, x_w of them in question.

Wilson's score interval is taken with that number, reduced for the m - 1 degrees of freedom of the
estimate by (z / t_(m-1))^2 (Korn and Graubard, Survey Methodology 24, 1998), as compared by Franco,
Little, Louis and Slud (Journal of Survey Statistics and Methodology 7, 2019). d lies between 1,
robots are independent, and n / m for worlds of one size: robots of a world all end alike.

Of an outcome that no robot had, or all, the worlds tell nothing: it takes the mean d of the others
(Rao and Scott, JASA 76, 1981); where all robots ended alike, a world counts once.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

Z = 1.959963984540054
"""Of 95 %."""


@dataclass(frozen=True, kw_only=True)
class ClusteredRate:
    """A fraction and its 95 % interval."""

    count: int
    rate: float
    low: float
    high: float
    effective: float
    """Independent robots that would tell as much: n / d, reduced for the degrees of freedom."""


def wilson_interval(count: float, total: float) -> tuple[float, float]:
    """Return the 95 % Wilson score interval of a proportion (Wilson, JASA 22, 1927).

    Args:
        count: in question.
        total: of all that are independent; neither needs to be whole.
    """
    if total <= 0:
        return 0.0, 1.0
    fraction = count / total
    scale = 1.0 + Z * Z / total
    centre = (fraction + Z * Z / (2 * total)) / scale
    half_width = (
        Z * math.sqrt(fraction * (1 - fraction) / total + Z * Z / (4 * total * total)) / scale
    )
    # Rounding must not keep the interval from the end that it reaches.
    low = max(0.0, centre - half_width) if count > 0 else 0.0
    return low, min(1.0, centre + half_width) if count < total else 1.0


def clustered_rates(
    has_outcome: Mapping[str, np.ndarray], world: np.ndarray
) -> dict[str, ClusteredRate]:
    """Return the rates of exclusive outcomes, with intervals clustered by world.

    Args:
        has_outcome: bool [n] by outcome: whether each robot had it.
        world: [n] in which each robot was.
    """
    total = len(world)
    if total == 0:
        return {
            name: ClusteredRate(count=0, rate=0.0, low=0.0, high=1.0, effective=0.0)
            for name in has_outcome
        }
    number, robots = np.unique(world, return_inverse=True, return_counts=True)[1:]
    max_effect = float(np.sum(robots.astype(float) ** 2)) / total
    effects = {name: _design_effect(hit, number, robots) for name, hit in has_outcome.items()}
    fractions = {name: float(np.mean(hit)) for name, hit in has_outcome.items()}
    weighted = [
        (1.0 - fractions[name], effect) for name, effect in effects.items() if effect is not None
    ]
    weight = sum(complement for complement, _ in weighted)
    mean = (
        sum(complement * effect for complement, effect in weighted) / weight
        if weighted
        else max_effect
    )
    rates = {}
    for name, effect in effects.items():
        design_effect = mean if effect is None else effect
        effective = total / min(max(design_effect, 1.0), max_effect)
        if max_effect > 1.0:
            effective *= (Z / student_quantile(len(robots) - 1)) ** 2
        low, high = wilson_interval(fractions[name] * effective, effective)
        rates[name] = ClusteredRate(
            count=int(np.sum(has_outcome[name])),
            rate=fractions[name],
            low=low,
            high=high,
            effective=effective,
        )
    return rates


@dataclass(frozen=True, kw_only=True)
class ClusteredMean:
    """A mean and its 95 % interval."""

    count: int
    """Values."""
    mean: float
    """NaN of no value, as the ends of the interval are of fewer than two worlds."""
    low: float
    high: float


def clustered_mean(values: np.ndarray, world: np.ndarray) -> ClusteredMean:
    """Return the mean of values that share worlds.

    A mean over robots is a ratio of sums over worlds: its variance is the estimator above with
    sums of values for counts of robots, and the interval is Student's with one degree of freedom
    fewer than worlds.

    Args:
        values: [n]; those that are not finite are left out.
        world: [n] of each.
    """
    is_finite = np.isfinite(values)
    values, world = np.asarray(values, float)[is_finite], np.asarray(world)[is_finite]
    if len(values) == 0:
        return ClusteredMean(count=0, mean=math.nan, low=math.nan, high=math.nan)
    mean = float(np.mean(values))
    world_index = np.unique(world, return_inverse=True)[1]
    worlds = int(world_index.max()) + 1
    if worlds < 2:
        return ClusteredMean(count=len(values), mean=mean, low=math.nan, high=math.nan)
    deviations = np.bincount(world_index, weights=values - mean)
    error = math.sqrt(worlds / (worlds - 1) * float(np.sum(deviations**2))) / len(values)
    half_width = student_quantile(worlds - 1) * error
    return ClusteredMean(
        count=len(values), mean=mean, low=mean - half_width, high=mean + half_width
    )


def _design_effect(hit: np.ndarray, number: np.ndarray, robots: np.ndarray) -> float | None:
    """Estimate the design effect of a fraction; None where that is impossible."""
    fraction, worlds = float(np.mean(hit)), len(robots)
    if fraction in (0.0, 1.0) or worlds < 2:
        return None
    counts = np.bincount(number, weights=hit, minlength=worlds)
    between = float(np.sum((counts - fraction * robots) ** 2)) * worlds / (worlds - 1)
    return between / (len(hit) * fraction * (1.0 - fraction))


def student_quantile(freedom: int) -> float:
    """Return the two-sided 95 % quantile of Student's t.

    Args:
        freedom: degrees of freedom; one is taken where there is none.
    """
    return float(stdtrit(max(freedom, 1), 0.975))
