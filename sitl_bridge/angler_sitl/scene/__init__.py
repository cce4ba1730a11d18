"""The simulator's own water and vehicles under real autopilots."""
