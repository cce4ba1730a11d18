"""Agents that learn to drive robots."""
