"""`angler sweep` and `angler compare`."""
