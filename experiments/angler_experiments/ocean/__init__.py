"""Fields of ocean models: a file for flights, and drift of particles in it."""
