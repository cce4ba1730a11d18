"""The commands of `angler dataset`."""
