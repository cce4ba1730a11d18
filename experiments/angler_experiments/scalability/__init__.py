"""Cost and arrivals over problem size: see docs/explanation/scalability.md."""
