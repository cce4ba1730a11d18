"""Evaluation of the learned planner by whole flights in worlds outside the training set."""
