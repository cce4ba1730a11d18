"""Commands on planners: plans, planning problems, and benchmarks."""
