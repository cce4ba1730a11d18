"""Datasets in formats of other projects, one robot's flight per episode."""
