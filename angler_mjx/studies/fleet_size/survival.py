"""Times of worlds that were not all done when they ended: Kaplan-Meier, and the restricted mean."""

import math
from dataclasses import dataclass

import numpy as np

CONFIDENCE = 0.95
"""Of the interval of a mean."""
Z = 1.959963984540054
"""Of `CONFIDENCE`."""


@dataclass(frozen=True, kw_only=True)
class SurvivalCurve:
    """Kaplan and Meier's estimate of the share that is not done yet (JASA 53, 1958)."""

    time_s: np.ndarray
    """[k] distinct times at which something was done, increasing."""
    left: np.ndarray
    """[k] share that is not done after each."""
    variance: np.ndarray
    """[k] of it, by Greenwood's formula (1926)."""
    at_risk: np.ndarray
    """int [k] worlds under observation just before each."""
    done: np.ndarray
    """int [k] worlds that were done at each."""


def estimate_curve(time_s: np.ndarray, done: np.ndarray) -> SurvivalCurve:
    """The curve of worlds, of which some were only watched for a while.

    Args:
        time_s: [n] when each was done, or until when it was watched.
        done: bool [n] whether it was done.
    """
    times = np.unique(time_s[done])
    at_risk = np.array([int(np.sum(time_s >= t)) for t in times], int)
    deaths = np.array([int(np.sum((time_s == t) & done)) for t in times], int)
    left = np.cumprod(1.0 - deaths / np.maximum(at_risk, 1))
    rest = at_risk - deaths
    with np.errstate(divide="ignore", invalid="ignore"):
        terms = np.where(rest > 0, deaths / (at_risk * np.maximum(rest, 1)), 0.0)
    variance = left**2 * np.cumsum(terms)
    return SurvivalCurve(time_s=times, left=left, variance=variance, at_risk=at_risk, done=deaths)


def restricted_mean(curve: SurvivalCurve, until_s: float) -> tuple[float, float, float]:
    """Mean of the time or ``until_s``, whichever is less, and its 95 % interval.

    The area under the curve; its variance is the sum over the times of the squared area that is
    left, times d / (r (r - d)), with d done of r at risk (Klein and Moeschberger, Survival
    Analysis, 2003, eq. 4.5.2). The interval is the normal one, for a number of worlds that was
    fixed beforehand.

    Args:
        curve: of the worlds.
        until_s: end of the observation.
    """
    inside = curve.time_s < until_s
    times = np.concatenate([[0.0], curve.time_s[inside], [until_s]])
    height = np.concatenate([[1.0], curve.left[inside]])
    areas = height * np.diff(times)
    mean = float(np.sum(areas))
    beyond = np.cumsum(areas[::-1])[::-1][1:]
    r, d = curve.at_risk[inside], curve.done[inside]
    rest = r - d
    terms = np.where(rest > 0, d / (r * np.maximum(rest, 1)), 0.0)
    half = Z * math.sqrt(float(np.sum(beyond**2 * terms)))
    return mean, max(0.0, mean - half), min(until_s, mean + half)
