"""Our part of the control of real autopilots."""
