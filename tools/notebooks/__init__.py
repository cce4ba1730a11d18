"""Notebooks of the documentation: run in new folders, stored with their outputs."""
