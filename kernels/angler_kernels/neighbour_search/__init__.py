"""The nearest of many bodies in one world, at a price per body that does not grow with them."""

from angler_kernels.neighbour_search.reference import nearest

__all__ = ["nearest"]
