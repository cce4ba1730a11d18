"""What the learned planner is worth: whole flights in worlds that nobody learned from."""
