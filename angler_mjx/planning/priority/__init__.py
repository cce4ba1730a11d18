"""Search over orders of priority, until the whole team has paths."""
