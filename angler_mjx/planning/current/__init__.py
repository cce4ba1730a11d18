"""Planner of paths of least energy or least time in moving water, in batches on the device."""
