"""What numba compiles for `edges` and `hulls`: balls and hulls swept among all there is."""
