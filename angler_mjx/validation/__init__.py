"""`angler validate`: what was measured against what, with how near it came, as a page and as JSON."""
