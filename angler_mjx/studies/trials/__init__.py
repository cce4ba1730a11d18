"""Trials of the controllers: the same courses for all of them, on every vehicle, with numbers."""
