"""Datasets read: arrays of one world at a time, episodes, windows of them."""
