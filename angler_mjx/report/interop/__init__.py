"""Exchange files for other programs: trajectories in JSON, runs as bags of ROS 2."""
