"""`angler validate`: what was measured against what, how near it came, as a page and as JSON."""
