"""Vehicles that somebody else started, behind MAVLink endpoints that the user names."""
