"""ArduSub's own control loops and mixer."""
