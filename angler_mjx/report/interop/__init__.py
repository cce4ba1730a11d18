"""Files that other programs read and write: trajectories in JSON, runs as bags of ROS 2."""
