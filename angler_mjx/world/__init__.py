"""Environments, obstacles, currents, tasks and acoustics: everything around the robots."""
