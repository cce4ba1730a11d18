"""Planner learned from plans: flow matching samples paths, closed forms choose among them."""
