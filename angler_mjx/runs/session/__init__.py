"""One scene, step by step, whatever drives it: the simulator, or real autopilots."""
