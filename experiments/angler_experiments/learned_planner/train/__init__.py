"""Training of the network and its examples."""
