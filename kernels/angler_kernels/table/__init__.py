"""Look-ups in sorted tables by bisection."""

from angler_kernels.table.reference import count_below, count_not_above, take

__all__ = ["count_below", "count_not_above", "take"]
