"""Verification of a dataset: its files, its values, and some of its flights flown again."""
