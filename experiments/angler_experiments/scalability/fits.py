"""Laws of costs: exponents on logarithmic axes with intervals, and fixed costs."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from angler_mjx.runs.storage.intervals import student


@dataclass(frozen=True, kw_only=True)
class Fit:
    """y = factor x^exponent, by least squares of the logarithms."""

    points: int
    factor: float
    exponent: float
    low: float
    """End of the exponent's 95 % interval, Student's with points - 2; NaN of two points."""
    high: float
    last: float
    """Exponent between the last two points: what more costs where there are many already."""


@dataclass(frozen=True, kw_only=True)
class Shares:
    """y = fixed + each x, neither below 0, by least squares of what is off in relation to y."""

    fixed: float
    each: float


def shares(x: Sequence[float], y: Sequence[float]) -> Shares | None:
    """Fit a fixed cost and one of each; None of fewer than two sizes.

    Args:
        x: sizes, above 0.
        y: costs, above 0.
    """
    if len(set(x)) < 2:
        return None
    u, v = np.asarray(x, float), np.asarray(y, float)
    both, _ = nnls(np.stack([1.0 / v, u / u.max() / v], axis=1), np.ones(len(u)))
    return Shares(fixed=float(both[0]), each=float(both[1] / u.max()))


def power(x: Sequence[float], y: Sequence[float]) -> Fit | None:
    """Fit a power law; None of fewer than two sizes.

    Args:
        x: sizes, above 0.
        y: costs, above 0.
    """
    if len(set(x)) < 2:
        return None
    order = np.argsort(x)
    u, v = np.log(np.asarray(x, float)[order]), np.log(np.asarray(y, float)[order])
    du = u - u.mean()
    exponent = float(du @ v / (du @ du))
    offset = float(v.mean() - exponent * u.mean())
    free = len(u) - 2
    half = math.nan
    if free > 0:
        left = v - offset - exponent * u
        half = student(free) * math.sqrt(float(left @ left) / free / float(du @ du))
    return Fit(
        points=len(u),
        factor=math.exp(offset),
        exponent=exponent,
        low=exponent - half,
        high=exponent + half,
        last=float((v[-1] - v[-2]) / (u[-1] - u[-2])),
    )
