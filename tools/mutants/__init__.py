"""Mutation testing: small faults are put into the code one at a time, and tests have to find them.

Places and faults come from Cosmic Ray's operators and a few of our own (`operators`); what is done
with them is ours, as it draws a sample, runs only what can know of a module, nearest tests first,
in several copies of the tree at once, and goes on where it was stopped. See docs/mutants.md.
"""
