"""Figures and replays, made from a run folder alone."""
