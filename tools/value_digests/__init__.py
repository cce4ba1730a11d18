"""Digests of the values that commands write, to be compared between two commits."""
