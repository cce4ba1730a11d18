"""Scenario files, checked before a run begins."""
