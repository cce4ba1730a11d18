"""Planners held against one another on the same problems."""
