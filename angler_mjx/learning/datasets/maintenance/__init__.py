"""Datasets that were made before: mended, joined, counted."""
