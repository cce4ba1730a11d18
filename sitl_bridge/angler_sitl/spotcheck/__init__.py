"""Episodes of a batch run that real autopilots fly again, and how far apart the two are."""
