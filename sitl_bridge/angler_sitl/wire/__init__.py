"""Socket traffic: servo packets, state and MAVLink."""
