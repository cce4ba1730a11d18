"""Real ArduSub processes behind the control interface of angler_mjx."""
