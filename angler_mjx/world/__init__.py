"""Environments, obstacles and currents: everything around the robots."""
