"""Numerical kernels of angler_mjx: arrays in, arrays out.

This package knows JAX and nothing of robots, files or scenarios. Each op has a folder or module of
its own with a readable reference; leading axes are added by the caller with ``jax.vmap``.
"""
