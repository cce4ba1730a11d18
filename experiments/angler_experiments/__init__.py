"""Shipped scenarios and studies of angler_mjx."""
