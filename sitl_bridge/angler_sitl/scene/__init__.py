"""Water and vehicles of the simulator under real autopilots."""
