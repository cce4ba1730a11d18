"""What the water and the thrusters do to a vehicle, and how one step of time is taken."""
