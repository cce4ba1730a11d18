"""Socket traffic: servo packets, state, MAVLink, and the lock-step."""
