"""What a robot's instruments tell it of its own motion, from the true motion and seeded noise."""
