"""What several commands share: the device, what a scenario is given, the bar."""
