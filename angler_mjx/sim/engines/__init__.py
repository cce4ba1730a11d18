"""The engines: each puts the phases of a control step together for tiles of worlds."""
