"""Commands that need real ArduSub."""
