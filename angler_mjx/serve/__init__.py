"""Live topics, services and actions of a session, for ROS 2, Zenoh and Foxglove."""
