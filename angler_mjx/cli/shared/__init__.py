"""Shared parts of the commands: device, scenario inputs, progress bars."""
