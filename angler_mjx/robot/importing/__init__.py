"""Vehicle files of other simulators, read into ours: URDF, xacro, SDF, MJCF."""
