"""The fused engine as Pallas kernels for a GPU."""
