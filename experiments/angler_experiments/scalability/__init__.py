"""What more of everything costs, and what it does to arrivals: see docs/scalability.md."""
