"""Planning on the host: worker processes, OMPL, and the checks of its edges.

The only room that imports ompl, pinocchio, coal and numba (extra ``plan``); nothing outside it
imports it before a planner of it is named.
"""
