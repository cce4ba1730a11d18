"""The ArduSub program: where it is, its parameters, its process and its boot."""
