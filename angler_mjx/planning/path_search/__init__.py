"""Path search of one robot in space and time: a lattice in bits, search, and string-pulling."""
