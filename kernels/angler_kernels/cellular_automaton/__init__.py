"""One step of a three-dimensional cellular automaton over walls and free cells."""

from angler_kernels.cellular_automaton.reference import block_count, step

__all__ = ["block_count", "step"]
