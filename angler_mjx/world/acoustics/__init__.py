"""Underwater acoustic communication: sound, noise, links, medium access, and reception."""
