"""What goes over sockets: servo packets, state, MAVLink, and the lock-step."""
