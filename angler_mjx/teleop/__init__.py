"""Teleoperation of a scene's robots, from a terminal or from a file of timed keys."""
