"""Ways to places of a world, worked out before the start, and the policy that flies them."""
