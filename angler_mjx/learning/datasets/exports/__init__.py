"""Datasets in the formats of others, a robot's flight each."""
