"""Fields of ocean models: a file to fly in, and what drifts in it."""
