"""Vehicle files, their parameter sets, and the parameters and MJCF compiled from them."""
