"""Benchmarks of planners, and their tables for a page."""
