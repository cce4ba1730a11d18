"""Planning in flight: passing order of late robots, and replanning."""
