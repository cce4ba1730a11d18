"""Planning problems of other benchmarks as scenarios: MovingAI, db-CBS and dynobench."""
