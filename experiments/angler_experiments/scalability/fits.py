"""Laws of costs: exponents on logarithmic axes with intervals, and fixed costs."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from angler_mjx.runs.storage.confidence_intervals import student_quantile


@dataclass(frozen=True, kw_only=True)
class PowerLawFit:
    """y = factor x^exponent, by least squares of the logarithms."""

    points: int
    factor: float
    exponent: float
    low: float
    """Lower end of the exponent's 95 % interval, Student's with points - 2; NaN of two points."""
    high: float
    last: float
    """Exponent between the last two points: the marginal cost at large sizes."""


@dataclass(frozen=True, kw_only=True)
class LinearFit:
    """y = fixed + each x, neither below 0, by least squares of relative residuals."""

    fixed: float
    each: float


def fit_linear(x: Sequence[float], y: Sequence[float]) -> LinearFit | None:
    """Fit a fixed cost and a cost per item; None of fewer than two sizes.

    Args:
        x: sizes, above 0.
        y: costs, above 0.
    """
    if len(set(x)) < 2:
        return None
    u, v = np.asarray(x, float), np.asarray(y, float)
    coefficients, _ = nnls(np.stack([1.0 / v, u / u.max() / v], axis=1), np.ones(len(u)))
    return LinearFit(fixed=float(coefficients[0]), each=float(coefficients[1] / u.max()))


def fit_power_law(x: Sequence[float], y: Sequence[float]) -> PowerLawFit | None:
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
    n_free = len(u) - 2
    half_width = math.nan
    if n_free > 0:
        residual = v - offset - exponent * u
        half_width = student_quantile(n_free) * math.sqrt(
            float(residual @ residual) / n_free / float(du @ du)
        )
    return PowerLawFit(
        points=len(u),
        factor=math.exp(offset),
        exponent=exponent,
        low=exponent - half_width,
        high=exponent + half_width,
        last=float((v[-1] - v[-2]) / (u[-1] - u[-2])),
    )
