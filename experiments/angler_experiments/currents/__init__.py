"""Studies of planning in currents."""
