"""OMPL's geometric planners for teams: one class each, by OMPL's name.

`planners` holds the classes and can be imported without OMPL; making one needs the extra ``plan``.
"""
