"""Planners against each other: the same problems for all, judged by how their plans fly."""
