"""Complete missions of a scenario on real autopilots."""
