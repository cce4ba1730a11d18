"""Intervals of a probability, and of a quantile, that hold however long one goes on looking.

Of n independent worlds s meet the deadline. For each p the ratio

    M(p) = B(a + s, b + n - s) / B(a, b) / (p^s (1 - p)^(n - s)),    B Euler's beta function,

of the likelihood averaged over a Beta(a, b) prior to the likelihood of p is a nonnegative
martingale of mean 1 if p is the truth (Robbins, Annals of Mathematical Statistics 41, 1970). By
Ville's inequality (1939) the probability that it ever reaches 1 / alpha is alpha at most. So the p
with M(p) < 1 / alpha are a confidence sequence: it holds the truth at all n at once with
1 - alpha, and one may stop, or go on, by what one sees. Nothing is approximate: for a discrete
count the coverage is the bound or better. See also Howard, Ramdas, McAuliffe and Sekhon (Annals of
Statistics 49, 2021).

One end alone is asked with its own alpha: the probability that the lower end ever exceeds the truth
is then at most that. The prior decides where intervals are shortest, not whether they hold; here it
has the mean of the probability in question and the weight of WEIGHT worlds.

A quantile t of a time is held by the same argument: the number of worlds that were done by t is
then a count with p known (Howard and Ramdas, Bernoulli 28, 2022).
"""

import bisect
import math
from collections.abc import Sequence

import numpy as np

PRIOR_WORLDS = 10.0
"""Worlds that the prior counts as."""
_HALVINGS = 60


def log_ratio(p: float, hits: int, total: int, prior_mean: float) -> float:
    """Logarithm of M(p).

    Args:
        p: [] probability, 0 to 1.
        hits: s.
        total: n.
        prior_mean: mean of the prior, inside 0 to 1.
    """
    return _log_averaged_likelihood(hits, total, prior_mean) - _log_likelihood(p, hits, total)


def _log_averaged_likelihood(hits: int, total: int, prior_mean: float) -> float:
    """Logarithm of the likelihood averaged over the prior."""
    a, b = PRIOR_WORLDS * prior_mean, PRIOR_WORLDS * (1.0 - prior_mean)
    return _log_beta(a + hits, b + total - hits) - _log_beta(a, b)


def _log_beta(a: float, b: float) -> float:
    return math.lgamma(a) + math.lgamma(b) - math.lgamma(a + b)


def _log_likelihood(p: float, hits: int, total: int) -> float:
    """Logarithm of the likelihood of p."""
    missed = total - hits
    if (hits and p <= 0.0) or (missed and p >= 1.0):
        return -math.inf
    return (hits * math.log(p) if hits else 0.0) + (missed * math.log1p(-p) if missed else 0.0)


def lower_bound(hits: int, total: int, alpha: float, prior_mean: float) -> float:
    """Lower end: the truth is ever below it with alpha at most.

    Args:
        hits: worlds that met the deadline.
        total: worlds.
        alpha: of this end.
        prior_mean: mean of the prior.
    """
    if hits == 0:
        return 0.0
    return _find_bound(0.0, hits / total, hits, total, alpha, prior_mean)


def upper_bound(hits: int, total: int, alpha: float, prior_mean: float) -> float:
    """Upper end; arguments as of `lower_bound`."""
    if hits == total:
        return 1.0
    return _find_bound(1.0, hits / total, hits, total, alpha, prior_mean)


def _find_bound(
    outside: float, inside: float, hits: int, total: int, alpha: float, prior_mean: float
) -> float:
    """Where M passes 1 / alpha between an end of 0 to 1 and the estimate, by halving.

    M falls from the end to the estimate, where it is least; the end outside is returned, so that
    rounding makes the interval wider.
    """
    threshold = _log_averaged_likelihood(hits, total, prior_mean) + math.log(alpha)
    for _ in range(_HALVINGS):
        middle = 0.5 * (outside + inside)
        if _log_likelihood(middle, hits, total) <= threshold:
            outside = middle
        else:
            inside = middle
    return outside


def estimate_quantile(
    times_s: Sequence[float] | np.ndarray, fraction: float, alpha: float
) -> tuple[float, float, float]:
    """A quantile of a time and its interval.

    Args:
        times_s: of all worlds; inf where it never came.
        fraction: of worlds that are done by the quantile.
        alpha: that the interval ever misses it, both ends together.

    Returns:
        Estimate (the first time by which so large a share was done), lower and upper end; inf where
        too few were done to say.
    """
    ordered = np.sort(np.asarray(times_s, float))
    total = len(ordered)
    if total == 0:
        return math.inf, 0.0, math.inf
    threshold = -math.log(alpha)

    def is_possible(k: int) -> bool:
        """Whether k worlds may be done by the quantile: it lies from the k-th time to the next."""
        return log_ratio(fraction, k, total, fraction) < threshold

    # M is convex in k and below 1 at the middle, so each way one number parts those that may be.
    middle = round(fraction * total)
    first = bisect.bisect_left(range(middle), True, key=is_possible)
    last = middle + bisect.bisect_left(
        range(middle + 1, total + 1), True, key=lambda k: not is_possible(k)
    )
    estimate = ordered[min(math.ceil(fraction * total - 1e-9), total) - 1]
    return (
        float(estimate),
        float(ordered[first - 1]) if first > 0 else 0.0,
        float(ordered[last]) if last < total else math.inf,
    )
