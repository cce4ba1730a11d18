"""Windows for those who train: orders that can be had again, PyTorch, Grain."""
