"""Small symmetric positive definite systems."""

from angler_kernels.spd_solve.reference import solve

__all__ = ["solve"]
