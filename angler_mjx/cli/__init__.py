"""The `angler` command."""
