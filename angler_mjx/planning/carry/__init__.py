"""Plans of robots that hold one body together."""
