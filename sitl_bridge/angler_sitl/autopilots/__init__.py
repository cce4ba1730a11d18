"""Real autopilots in lock-step with one scene: start, boot, step, view."""
