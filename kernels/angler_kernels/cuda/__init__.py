"""Kernels of one thread a lane, written in JAX, emitted as CUDA C and compiled by NVRTC."""
