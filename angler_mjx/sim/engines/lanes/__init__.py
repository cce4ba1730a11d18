"""The fused engine in plain JAX: robots and worlds side by side on lanes."""
