"""Vehicle files, their parameter sets, and what they compile to: parameters and MJCF."""
