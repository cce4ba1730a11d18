"""The way of one robot through space and time: a lattice in bits, search, and string-pulling."""
