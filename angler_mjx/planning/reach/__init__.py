"""Policy that brings end effectors to the goals."""
