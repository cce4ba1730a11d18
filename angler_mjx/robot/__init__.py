"""One robot: its vehicle file, its controllers and its instruments."""
