"""Flights of single vehicles in open water: courses, draws, flying, measures."""
