"""Planners: from an environment and a fleet to one trajectory per robot."""
