"""Benchmarks of planners, and their tables for documents."""
