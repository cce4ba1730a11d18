"""Tuning: gains of a controller found on thousands of flights, with what they are worth."""
