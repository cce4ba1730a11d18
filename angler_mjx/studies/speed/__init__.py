"""`angler bench`: measured speed, with what was measured and where."""
