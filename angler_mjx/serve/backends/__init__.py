"""Transports of live topics, each an adapter of one library."""
