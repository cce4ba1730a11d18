"""A thruster: static curve by table, its inverse, and the rotor's lag or filter."""

from angler_kernels.thruster.reference import inverse_lookup, lookup, rotor_filter, rotor_lag

__all__ = ["inverse_lookup", "lookup", "rotor_filter", "rotor_lag"]
