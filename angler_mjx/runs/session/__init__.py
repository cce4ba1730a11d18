"""Interactive session of one scene, step by step: the simulator, or real autopilots."""
