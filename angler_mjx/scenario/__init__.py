"""Scenario files: what a run needs to know, checked before anything is computed."""
