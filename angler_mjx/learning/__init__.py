"""Environments for reinforcement learning over a `Simulator`: pure JAX, and Gymnasium's vectors."""
