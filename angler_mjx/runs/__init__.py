"""From a scenario file to a run folder: tiles of worlds, recording, results."""
