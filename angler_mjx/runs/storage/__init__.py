"""Everything on disk: run folders, trajectories, results, environments."""
