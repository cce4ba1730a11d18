"""Functions compiled by numba for `edges` and `hulls`: sweeps of balls and hulls."""
