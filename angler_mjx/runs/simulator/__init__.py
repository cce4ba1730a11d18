"""Runnable scenario: sampled and planned worlds, compiled steps, devices."""
