"""The simulator against motion capture of a BlueROV2 Heavy with a Reach Alpha 5 in a wave flume."""
