"""Maps: of a whole world, and of the surroundings of one robot in two runs."""
