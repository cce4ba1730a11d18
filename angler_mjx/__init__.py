"""Underwater multi-robot simulation in batches, on JAX and MJX."""

__version__ = "0.1.0"
