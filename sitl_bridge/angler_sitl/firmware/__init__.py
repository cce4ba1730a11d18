"""ArduSub program: its location, parameters, process and boot."""
