"""Whole flights of a scenario on real autopilots."""
