"""What independent draws look like: no two columns of many draws go together."""

import numpy as np


def assert_uncorrelated(columns, names=None):
    """Every pair of columns [n, k] has a correlation below 5 / sqrt(n).

    The correlation of n independent pairs has a standard deviation of 1 / sqrt(n): five of those
    are passed once in 1.7 million pairs. Ranks stand for the values, so that no heavy tail counts
    for more than that.
    """
    columns = np.asarray(columns, np.float64)
    n, k = columns.shape
    assert (columns.std(axis=0) > 0).all(), "a column that does not vary says nothing"
    ranks = np.empty_like(columns)
    for j in range(k):  # equal values get the mean of their ranks
        _, same, count = np.unique(columns[:, j], return_inverse=True, return_counts=True)
        ranks[:, j] = (np.cumsum(count) - 0.5 * count)[same]
    r = np.corrcoef(ranks, rowvar=False)
    np.fill_diagonal(r, 0.0)
    i, j = np.unravel_index(np.argmax(np.abs(r)), r.shape)
    pair = (i, j) if names is None else (names[i], names[j])
    assert abs(r[i, j]) < 5 / np.sqrt(n), f"{pair} go together: r = {r[i, j]:.3f} of {n}"
