"""Acoustic communication: range of packets, and age of information."""
