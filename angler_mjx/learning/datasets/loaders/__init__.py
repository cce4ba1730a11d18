"""Windows for training: reproducible orders, PyTorch, Grain."""
