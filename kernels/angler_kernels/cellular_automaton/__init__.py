"""One step of a three-dimensional cellular automaton over walls and free cells."""

from angler_kernels.cellular_automaton.reference import neighbour_count, step

__all__ = ["neighbour_count", "step"]
