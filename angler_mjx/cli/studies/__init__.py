"""`angler sweep`, `angler compare` and `angler study`."""
