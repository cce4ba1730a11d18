"""Robots of a scene driven by a person at a terminal, or by a file of timed keys."""
