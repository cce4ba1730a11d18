"""Boolean grids with 32 cells in a word, and their shifts."""

from angler_kernels.bit_grid.reference import WORD, everywhere, pack, population, shift, unpack

__all__ = ["WORD", "everywhere", "pack", "population", "shift", "unpack"]
