"""Environments for reinforcement learning over a `Simulator`, and datasets of flights."""
