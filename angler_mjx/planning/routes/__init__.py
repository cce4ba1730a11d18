"""Routes to places of a world, computed before the start, and the policy that follows them."""
