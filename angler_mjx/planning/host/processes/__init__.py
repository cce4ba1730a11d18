"""Processes for planners: how one is begun, talked to and ended."""
