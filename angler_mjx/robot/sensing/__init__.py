"""Instruments of a robot: readings of its own motion from the true motion and seeded noise."""
