"""Mutation testing: small faults are put into the code one at a time, and tests have to find them.

Positions and faults come from Cosmic Ray's operators and a few of our own (`operators`). The rest
is ours: it takes a sample, runs only the tests that can detect faults of a module, nearest first,
in several copies of the tree at once, and resumes after an interruption: docs/how_to/mutants.md.
"""
