"""Static cells of a world: their grid, and the rules that generate them."""
