"""ArduSub program: its location, parameters, process and ports."""
