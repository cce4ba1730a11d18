"""Maps: of a whole world, and of what is around one robot in two runs."""
