"""Commands, pure controllers with explicit carry, and the trajectories that drive them."""
