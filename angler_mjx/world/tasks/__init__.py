"""Tasks of a fleet: places to visit, surfaces to see, goods to bring; who does what, who knows."""
