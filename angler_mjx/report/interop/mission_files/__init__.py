"""Mission files of ground stations: read, turned into plans or tours, and written."""
