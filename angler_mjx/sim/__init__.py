"""State, physics, one control step, contact detection, outcomes, and the engines that repeat it."""
